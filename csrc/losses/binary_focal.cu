// The binary focal loss on CUDA.
#include "binary_focal.h"
#include "metrics/pointwise.cuh"

namespace kv::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    sum_binary_focal(__grid_constant__ BinaryFocalSum<T> const p, bool packed) {
  using F = Compute<T>;
  let_next_begin();
  int64_t const row = blockIdx.x / p.pieces;
  BinaryFocalTerms<F> const terms = p.terms.of(row);
  F sum = 0;
  for_each_pack(p.pair, row, blockIdx.x - row * p.pieces, packed, [&](int64_t, auto const& x, auto const& t) {
#pragma unroll
    for (int i = 0; i < int(sizeof(x) / sizeof(F)); ++i)
      sum += BinaryFocalPoint<F, PointMath<F>, F>(terms, x[i]).loss(t[i]);
  });
  sum = block_sum(sum);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    map_binary_focal(__grid_constant__ BinaryFocalMap<T> const p, int64_t pieces, bool packed) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / pieces;
  BinaryFocalTerms<F> const terms = p.terms.of(row);
  F const of_row = p.grad_of_sum ? p.grad_of_sum[row] : F(1);
  for_each_pack(p.pair, row, blockIdx.x - row * pieces, packed, [&](int64_t e, auto const& x, auto const& t) {
    constexpr int P = sizeof(x) / sizeof(F);
    F result[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      BinaryFocalPoint<F, PointMath<F>, F> const at(terms, x[i]);
      if (p.grad || p.grad_of_sum)
        result[i] = (p.by_target ? at.slope_by_target(t[i]) : at.slope(t[i])) * (p.grad ? read(p.grad[e + i]) : of_row);
      else
        result[i] = at.loss(t[i]);
    }
    store_pack(p.out + e, result);
  });
}

}  // namespace

template <class T>
int binary_focal_sum(BinaryFocalSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  sum_binary_focal<<<unsigned(rows * p.pieces), kSumThreads, 0, stream>>>(p, is_packed(p.pair, nullptr));
  return add_up(p.partial, rows, p.pieces, p.sums, stream);
}

template <class T>
int binary_focal_map(BinaryFocalMap<T> const& p, CUstream_st* stream) {
  int64_t const pieces = point_pieces(p.pair.size);
  map_binary_focal<<<unsigned(p.pair.rows * pieces), kSumThreads, 0, stream>>>(p, pieces, is_packed(p.pair, p.out));
  return cudaGetLastError();
}

KV_INSTANTIATE(binary_focal_sum, BinaryFocalSum)
KV_INSTANTIATE(binary_focal_map, BinaryFocalMap)

}  // namespace kv::cuda
