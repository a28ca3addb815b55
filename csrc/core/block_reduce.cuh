// Reductions and prefix sums over the threads of a warp or a block, with results that do not depend on timing. Included
// by *.cu files.
#pragma once

#include "launch.cuh"

namespace kv {
namespace {

// The sum of x over the threads of a warp up to this one.
template <class F>
__device__ __forceinline__ F warp_prefix_sum(F x) {
#pragma unroll
  for (int step = 1; step < 32; step *= 2) {
    F const preceding = __shfl_up_sync(0xffffffffu, x, step);
    if (int(threadIdx.x % 32) >= step) x += preceding;
  }
  return x;
}

// The sum over the threads of a block, returned to the first one. Warps are added up in order; a block may have fewer
// than `Threads`.
template <int Threads, class F>
__device__ __forceinline__ F block_sum(F x, int warps = Threads / 32) {
  __shared__ F warp_sums[Threads / 32];
  x = warp_reduce(x, Sum());
  if (threadIdx.x % 32 == 0) warp_sums[threadIdx.x / 32] = x;
  __syncthreads();
  F sum = 0;
  for (int w = 0; w < warps; ++w) sum += warp_sums[w];
  return sum;
}

// The sum over the threads of a block, returned to all of them. `memory` has a number per warp.
template <int Warps, class F>
__device__ __forceinline__ F block_sum_to_all(F x, F (&memory)[Warps]) {
  x = warp_reduce(x, Sum());
  __syncthreads();  // the memory may be in use for another sum
  if (threadIdx.x % 32 == 0) memory[threadIdx.x / 32] = x;
  __syncthreads();
  F total = 0;
#pragma unroll
  for (int w = 0; w < Warps; ++w) total += memory[w];
  return total;
}

// Stores the sums of N numbers over the threads of a block, which all call it. The sums of warps are added in the type
// of the results.
template <int Threads, int N, class F, class R>
__device__ __forceinline__ void store_block_sums(F const (&sums)[N], R* to) {
  __shared__ F warp_sums[N][Threads / 32];
  __syncthreads();  // the memory may be in use for other sums
#pragma unroll
  for (int i = 0; i < N; ++i) {
    F const sum = warp_reduce(sums[i], Sum());
    if (threadIdx.x % 32 == 0) warp_sums[i][threadIdx.x / 32] = sum;
  }
  __syncthreads();
  if (threadIdx.x < N) {
    R sum = 0;
    for (F const part : warp_sums[threadIdx.x]) sum += part;
    to[threadIdx.x] = sum;
  }
}

// The sums of `count` rows of N numbers, in shared memory, for all threads of a block, which all call it.
template <int Threads, int N>
__device__ __forceinline__ double* sum_rows(double const* rows, int64_t count) {
  __shared__ double total[N];
  double sums[N] = {};
  for (int64_t row = threadIdx.x; row < count; row += Threads)
    for (int i = 0; i < N; ++i) sums[i] += rows[row * N + i];
  store_block_sums<Threads>(sums, total);
  __syncthreads();
  return total;
}

// An operation for block_reduce.
struct NanMax {
  template <class F>
  __device__ __forceinline__ F operator()(F a, F b) const {
    return a != a || a > b ? a : b;  // NaN if either is NaN
  }
};
// Reduces K numbers over the threads of a block, and returns the results to all of them.
template <int Threads, int K, class F, class Op>
__device__ __forceinline__ void block_reduce(F (&v)[K], Op op) {
  constexpr int kWarps = Threads / 32;
  __shared__ F warp_results[K][kWarps];
  __syncthreads();  // the memory may be in use for another reduction
#pragma unroll
  for (int k = 0; k < K; ++k) {
    v[k] = warp_reduce(v[k], op);
    if (threadIdx.x % 32 == 0) warp_results[k][threadIdx.x / 32] = v[k];
  }
  __syncthreads();
#pragma unroll
  for (int k = 0; k < K; ++k) {
    v[k] = warp_results[k][0];
    for (int w = 1; w < kWarps; ++w) v[k] = op(v[k], warp_results[k][w]);
  }
}

}  // namespace
}  // namespace kv
