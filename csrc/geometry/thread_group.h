// The threads that work on one problem, like a cooperative group: a single thread on the CPU, a block on CUDA. The
// threads take correspondences in turns. Included by kernels that sum over correspondences.
//
//   sum, sums          sums over the threads of the group; every thread calls it and gets the result
//   SharedStorage<X>   memory for an X that all threads of the group share
//   first_warp         the threads that continue if there is little work; the others are idle
#pragma once

#include "core/hd.h"
#if defined(__CUDACC__)
#include "core/warp_reduce.cuh"
#endif

namespace kv::geometry {

struct SingleThread {
  KV_HD int thread_rank() const { return 0; }
  KV_HD int num_threads() const { return 1; }
  KV_HD void sync() const {}
  KV_HD bool all(bool x) const { return x; }
  KV_HD double sum(double x) const { return x; }
  template <int K>
  KV_HD double const* sums(double (&x)[K]) const {
    return x;
  }
  template <class X>
  struct SharedStorage {
    X value;
    KV_HD X& get() { return value; }
  };
  KV_HD SingleThread first_warp() const { return {}; }
  KV_HD bool is_idle() const { return false; }
};

#if defined(__CUDACC__)
// The number of threads of a block for a problem of `count` correspondences.
constexpr int kMaxThreads = 256;
inline unsigned block_size(int64_t count) { return count > kMaxThreads ? kMaxThreads : 32; }

// The first warp of a block.
struct FirstWarp {
  __device__ __forceinline__ int thread_rank() const { return threadIdx.x; }
  __device__ __forceinline__ int num_threads() const { return 32; }
  __device__ __forceinline__ void sync() const { __syncwarp(); }
  __device__ __forceinline__ bool all(bool x) const { return __all_sync(0xffffffffu, x); }
  __device__ __forceinline__ bool is_idle() const { return threadIdx.x >= 32; }
};

struct ThreadBlock {
  __device__ __forceinline__ int thread_rank() const { return threadIdx.x; }
  __device__ __forceinline__ int num_threads() const { return blockDim.x; }
  __device__ __forceinline__ void sync() const { __syncthreads(); }
  __device__ __forceinline__ double sum(double x) const {
    double value[] = {x};
    return *sums(value);
  }
  // The result stays valid until the next sums of K numbers.
  template <int K>
  __device__ __forceinline__ double const* sums(double (&x)[K]) const {
    __shared__ double warp_sums[kMaxThreads / 32][K];
#pragma unroll
    for (double& v : x) v = warp_reduce(v, Sum());
    __syncthreads();  // other threads may still read the last sums
    if (threadIdx.x % 32 == 0)
#pragma unroll
      for (int k = 0; k < K; ++k) warp_sums[threadIdx.x / 32][k] = x[k];
    __syncthreads();
    if (blockDim.x > 32) {
      for (unsigned k = threadIdx.x; k < K; k += blockDim.x)
        for (unsigned w = 1; w < blockDim.x / 32; ++w) warp_sums[0][k] += warp_sums[w][k];
      __syncthreads();
    }
    return warp_sums[0];
  }
  template <class X>
  struct SharedStorage {
    static __device__ __forceinline__ X& get() {
      __shared__ X value;
      return value;
    }
  };
  __device__ __forceinline__ FirstWarp first_warp() const { return {}; }
};
#endif

}  // namespace kv::geometry
