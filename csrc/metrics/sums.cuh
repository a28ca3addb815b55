// Sums on CUDA: each block leaves one number for its piece of a row, and another kernel adds these up, always in the
// same order. Included by *.cu files.
#pragma once

#include "core/launch.cuh"
#include "core/reciprocal.cuh"
#include "metrics/sums.h"

namespace kv::cuda {
namespace {

constexpr int kSumThreads = 256;

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

// Reductions of K numbers over a block, to all of its threads.
struct Larger {
  template <class F>
  __device__ __forceinline__ F operator()(F a, F b) const {
    return a != a || a > b ? a : b;  // NaN, if there is one
  }
};
struct Plus {
  template <class F>
  __device__ __forceinline__ F operator()(F a, F b) const {
    return a + b;
  }
};
template <int Threads = kSumThreads, int K, class F, class Op>
__device__ __forceinline__ void over_block(F (&v)[K], Op op) {
  constexpr int kWarps = Threads / 32;
  __shared__ F of_warps[K][kWarps];
  __syncthreads();  // with what was there before
#pragma unroll
  for (int k = 0; k < K; ++k) {
#pragma unroll
    for (int lane = 16; lane > 0; lane /= 2) v[k] = op(v[k], __shfl_xor_sync(0xffffffffu, v[k], lane));
    if (threadIdx.x % 32 == 0) of_warps[k][threadIdx.x / 32] = v[k];
  }
  __syncthreads();
#pragma unroll
  for (int k = 0; k < K; ++k) {
    v[k] = of_warps[k][0];
    for (int w = 1; w < kWarps; ++w) v[k] = op(v[k], of_warps[k][w]);
  }
}

// partial (rows, pieces) to sums (rows): a block for each row.
template <class F>
__global__ void __launch_bounds__(kSumThreads)
    finish_sums(F const* partial, int64_t pieces, Finish<F> const finish, F* sums) {
  F sum = 0;
  F const* const row = partial + blockIdx.x * pieces;
#pragma unroll 8
  for (int64_t i = threadIdx.x; i < pieces; i += kSumThreads) sum += row[i];
  sum = block_sum(sum);
  if (threadIdx.x == 0) sums[blockIdx.x] = finish(sum);
}

template <class F>
int add_up(F const* partial, int64_t rows, int64_t pieces, F* sums, CUstream_st* stream, Finish<F> finish = {1, 0}) {
  finish_sums<<<unsigned(rows), kSumThreads, 0, stream>>>(partial, pieces, finish, sums);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::cuda
