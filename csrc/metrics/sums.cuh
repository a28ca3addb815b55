// Sums on CUDA: each block leaves one number for its piece of a row, and another kernel adds these up, always in the
// same order. It is launched early; kernels that leave sums say let_next_begin. Included by *.cu files.
#pragma once

#include "core/early_launch.cuh"
#include "metrics/sums.h"

namespace kv::cuda {
namespace {

constexpr int kSumThreads = 256;

// As cheap as fast_sqrt, and as good.
__device__ __forceinline__ float fast_reciprocal(float x) {
  float y;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ double fast_reciprocal(double x) { return 1 / x; }

// The sum over a block, to its first thread.
template <int Threads = kSumThreads, class F>
__device__ __forceinline__ F block_sum(F x) {
  constexpr int kWarps = Threads / 32;
  __shared__ F of_warps[kWarps];
  x = warp_sum(x);
  if (threadIdx.x % 32 == 0) of_warps[threadIdx.x / 32] = x;
  __syncthreads();
  F sum = 0;
  for (int w = 0; w < kWarps; ++w) sum += of_warps[w];
  return sum;
}

// partial (rows, pieces) to sums (rows): a block for each row.
template <class F>
__global__ void __launch_bounds__(kSumThreads)
    finish_sums(F const* partial, int64_t pieces, Finish<F> const finish, F* sums) {
  wait_for_previous();
  F sum = 0;
  F const* const row = partial + blockIdx.x * pieces;
#pragma unroll 8
  for (int64_t i = threadIdx.x; i < pieces; i += kSumThreads) sum += row[i];
  sum = block_sum(sum);
  if (threadIdx.x == 0) sums[blockIdx.x] = finish(sum);
}

template <class F>
int add_up(F const* partial, int64_t rows, int64_t pieces, F* sums, CUstream_st* stream, Finish<F> finish = {1, 0}) {
  return launch_early(finish_sums<F>, unsigned(rows), kSumThreads, stream, partial, pieces, finish, sums);
}

}  // namespace
}  // namespace kv::cuda
