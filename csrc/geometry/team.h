// Who works on one problem: a thread alone, or the threads of a block, a warp or several, which take correspondences in
// turns. Included by kernels whose sums are over correspondences.
#pragma once

#include "core/hd.h"

namespace kv {

struct Alone {
  KV_HD int64_t first() const { return 0; }
  KV_HD int64_t step() const { return 1; }
  KV_HD double sum(double x) const { return x; }
};

#if defined(__CUDACC__)
struct Block {
  __device__ __forceinline__ int64_t first() const { return threadIdx.x; }
  __device__ __forceinline__ int64_t step() const { return blockDim.x; }
  // To all threads, which all call it.
  __device__ __forceinline__ double sum(double x) const {
    __shared__ double parts[32];
    for (int lane = 16; lane > 0; lane /= 2) x += __shfl_xor_sync(0xffffffffu, x, lane);
    if (blockDim.x <= 32) return x;
    __syncthreads();  // of who reads the last sum
    if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = x;
    __syncthreads();
    x = 0;
    for (unsigned w = 0; w < blockDim.x / 32; ++w) x += parts[w];
    return x;
  }
};

// How many threads take a problem of so many correspondences.
constexpr int kMostThreads = 256;
inline unsigned team_size(int64_t count) { return count > kMostThreads ? kMostThreads : 32; }
#endif

}  // namespace kv
