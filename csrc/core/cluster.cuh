// Clusters: blocks that run together and read each other's shared memory, from sm_90 on. Included by *.cu files.
#pragma once

#include "launch.cuh"

namespace kv {

constexpr int kMaxClusterSize = 8;  // that every GPU with clusters has

// A barrier of all threads of a cluster, in two halves: what a thread did before it arrives is seen after waiting.
__device__ __forceinline__ void cluster_arrive() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  asm volatile("barrier.cluster.arrive.aligned;" ::: "memory");
#endif
}
__device__ __forceinline__ void cluster_wait() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  asm volatile("barrier.cluster.wait.aligned;" ::: "memory");
#endif
}

// A number in the shared memory of block `rank` of the cluster, at the address that it has in this block.
__device__ __forceinline__ int load_of_block(int const* shared, unsigned rank) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  uint32_t at;
  int x;
  asm("mapa.shared::cluster.u32 %0, %1, %2;" : "=r"(at) : "r"(uint32_t(__cvta_generic_to_shared(shared))), "r"(rank));
  asm volatile("ld.shared::cluster.s32 %0, [%1];" : "=r"(x) : "r"(at) : "memory");
  return x;
#else
  return *shared;
#endif
}

// Whether `kernel` can run in clusters: it depends on the GPU, and on what the code was compiled for.
template <class Kernel>
bool supports_clusters(Kernel* kernel) {
  static bool const result = [&] {
    int device = 0, supported = 0;
    cudaFuncAttributes attributes{};
    return !cudaGetDevice(&device) && !cudaDeviceGetAttribute(&supported, cudaDevAttrClusterLaunch, device) &&
           supported && !cudaFuncGetAttributes(&attributes, kernel) && attributes.ptxVersion >= 90;
  }();
  return result;
}

// Launches blocks in clusters of `size`, which divides their number. A size of 1 is an ordinary launch.
template <class... Parameters, class... Arguments>
cudaError_t launch_clusters(void (*kernel)(Parameters...), unsigned blocks, unsigned threads, size_t shared_bytes,
                            unsigned size, cudaStream_t stream, Arguments... arguments) {
  cudaLaunchConfig_t config{};
  config.gridDim = dim3(blocks);
  config.blockDim = dim3(threads);
  config.dynamicSmemBytes = shared_bytes;
  config.stream = stream;
  cudaLaunchAttribute cluster{};
  cluster.id = cudaLaunchAttributeClusterDimension;
  cluster.val.clusterDim.x = size, cluster.val.clusterDim.y = cluster.val.clusterDim.z = 1;
  config.attrs = &cluster;
  config.numAttrs = size > 1;
  return cudaLaunchKernelEx(&config, kernel, Parameters(arguments)...);
}

}  // namespace kv
