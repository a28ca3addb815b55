// Who works on one problem: a thread alone, or the threads of a block, a warp or several, which take correspondences in
// turns. Included by kernels whose sums are over correspondences.
//
//   sum, sums      of all threads' numbers, to all of them, which all call it
//   Kept<X>        memory for an X that all of them see
//   few            those who go on where there is less to do: a warp; the others are idle
#pragma once

#include "core/hd.h"

namespace kv {

struct Alone {
  KV_HD int first() const { return 0; }
  KV_HD int step() const { return 1; }
  KV_HD void sync() const {}
  KV_HD bool all(bool x) const { return x; }
  KV_HD double sum(double x) const { return x; }
  template <int K>
  KV_HD double const* sums(double (&x)[K]) const {
    return x;
  }
  template <class X>
  struct Kept {
    X value;
    KV_HD X& get() { return value; }
  };
  KV_HD Alone few() const { return {}; }
  KV_HD bool idle() const { return false; }
};

#if defined(__CUDACC__)
// How many threads take a problem of so many correspondences.
constexpr int kMostThreads = 256;
inline unsigned team_size(int64_t count) { return count > kMostThreads ? kMostThreads : 32; }

// The first warp of a block.
struct Warp {
  __device__ __forceinline__ int first() const { return threadIdx.x; }
  __device__ __forceinline__ int step() const { return 32; }
  __device__ __forceinline__ void sync() const { __syncwarp(); }
  __device__ __forceinline__ bool all(bool x) const { return __all_sync(0xffffffffu, x); }
  __device__ __forceinline__ bool idle() const { return threadIdx.x >= 32; }
};

struct Block {
  __device__ __forceinline__ int first() const { return threadIdx.x; }
  __device__ __forceinline__ int step() const { return blockDim.x; }
  __device__ __forceinline__ void sync() const { __syncthreads(); }
  __device__ __forceinline__ double sum(double x) const {
    double one[] = {x};
    return *sums(one);
  }
  // In memory that the next sums of as many numbers take.
  template <int K>
  __device__ __forceinline__ double const* sums(double (&x)[K]) const {
    __shared__ double parts[kMostThreads / 32][K];
#pragma unroll
    for (double& v : x)
      for (int lane = 16; lane > 0; lane /= 2) v += __shfl_xor_sync(0xffffffffu, v, lane);
    __syncthreads();  // of who reads the last sums
    if (threadIdx.x % 32 == 0)
#pragma unroll
      for (int k = 0; k < K; ++k) parts[threadIdx.x / 32][k] = x[k];
    __syncthreads();
    if (blockDim.x > 32) {
      for (unsigned k = threadIdx.x; k < K; k += blockDim.x)
        for (unsigned w = 1; w < blockDim.x / 32; ++w) parts[0][k] += parts[w][k];
      __syncthreads();
    }
    return parts[0];
  }
  template <class X>
  struct Kept {
    static __device__ __forceinline__ X& get() {
      __shared__ X value;
      return value;
    }
  };
  __device__ __forceinline__ Warp few() const { return {}; }
};
#endif

}  // namespace kv
