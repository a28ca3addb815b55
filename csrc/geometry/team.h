// Who works on one problem: a thread alone, or the threads of a warp, each on every 32nd correspondence. Included by
// kernels whose sums are over correspondences.
#pragma once

#include "core/hd.h"

namespace kv {

struct Alone {
  KV_HD int64_t first() const { return 0; }
  KV_HD int64_t step() const { return 1; }
  KV_HD double sum(double x) const { return x; }
};

#if defined(__CUDACC__)
struct Warp {
  __device__ __forceinline__ int64_t first() const { return threadIdx.x % 32; }
  __device__ __forceinline__ int64_t step() const { return 32; }
  __device__ __forceinline__ double sum(double x) const {
    for (int lane = 16; lane > 0; lane /= 2) x += __shfl_xor_sync(0xffffffffu, x, lane);
    return x;
  }
};
#endif

}  // namespace kv
