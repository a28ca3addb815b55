// Sums of rows on CUDA: each block leaves the sum of a chunk of a row, and another kernel adds these up, always in the
// same order. Included by *.cu files.
#pragma once

#include "block_reduce.cuh"
#include "reciprocal.cuh"
#include "row_sums.h"

namespace kv {
namespace {

constexpr int kSumThreads = 256;

// partial (rows, chunks) to sums (rows): a block for each row.
template <class F>
__global__ void __launch_bounds__(kSumThreads)
    finalize_sums(F const* partial, int64_t chunks, FinalizeSum<F> const finalize, F* sums) {
  F sum = 0;
  F const* const row = partial + blockIdx.x * chunks;
#pragma unroll 8
  for (int64_t i = threadIdx.x; i < chunks; i += kSumThreads) sum += row[i];
  sum = block_sum<kSumThreads>(sum);
  if (threadIdx.x == 0) sums[blockIdx.x] = finalize(sum);
}

template <class F>
int sum_chunks(F const* partial, int64_t rows, int64_t chunks, F* sums, CUstream_st* stream,
               FinalizeSum<F> finalize = {1, 0}) {
  finalize_sums<<<unsigned(rows), kSumThreads, 0, stream>>>(partial, chunks, finalize, sums);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv
