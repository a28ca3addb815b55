// Launches that begin while the one before them ends: their blocks come to the multiprocessors that this leaves empty,
// and wait there until it is done, which takes less than to start them then. For launches of few blocks, or short ones:
// where the others leave room first, not evenly, is where they stay. Included by *.cu files.
#pragma once

#include "launch.cuh"

namespace kv::cuda {
namespace {

// In a kernel that launch_early is to follow: the next one may begin once all of its blocks have come here or ended.
__device__ __forceinline__ void let_next_begin() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  asm volatile("griddepcontrol.launch_dependents;");
#endif
}

// In a kernel that is launched early, in every block and before it reads or writes memory: until all that came before
// is done and can be seen.
__device__ __forceinline__ void wait_for_previous() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  asm volatile("griddepcontrol.wait;" ::: "memory");
#endif
}

// Whether the device surely runs code in which wait_for_previous waits, and the driver captures such launches, too.
inline bool can_launch_early() {
  int device = 0, major = 0, minor = 0, driver = 0;
  cudaGetDevice(&device);
  if (cudaDriverGetVersion(&driver) || driver < 12030) return false;
  cudaDeviceGetAttribute(&major, cudaDevAttrComputeCapabilityMajor, device);
  cudaDeviceGetAttribute(&minor, cudaDevAttrComputeCapabilityMinor, device);
  for (int const compiled : {__CUDA_ARCH_LIST__})
    if (compiled >= 900 && compiled / 100 == major && compiled % 100 / 10 <= minor) return true;
  return false;
}

template <class... Params, class... Args>
int launch_early(void (*kernel)(Params...), unsigned blocks, int threads, CUstream_st* stream, Args const&... args) {
  cudaLaunchAttribute early{};
  early.id = cudaLaunchAttributeProgrammaticStreamSerialization;
  early.val.programmaticStreamSerializationAllowed = 1;
  cudaLaunchConfig_t launch{};
  launch.gridDim = blocks, launch.blockDim = unsigned(threads), launch.stream = stream;
  launch.attrs = &early, launch.numAttrs = can_launch_early();
  return cudaLaunchKernelEx(&launch, kernel, args...);
}

}  // namespace
}  // namespace kv::cuda
