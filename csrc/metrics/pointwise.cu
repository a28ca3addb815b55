// Losses element by element on CUDA: a block takes a piece of a row, each thread four elements of both tensors at a
// time.
#include "pointwise.cuh"

namespace kv::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kSumThreads) sum_points(__grid_constant__ PointwiseSum<T> const p, bool packed) {
  using F = Compute<T>;
  let_next_begin();
  int64_t const row = blockIdx.x / p.pieces;
  F sum = 0;
  for_each_pack(p.pair, row, blockIdx.x - row * p.pieces, packed, [&](int64_t, auto const& x, auto const& y) {
#pragma unroll
    for (int i = 0; i < int(sizeof(x) / sizeof(F)); ++i) sum += point_loss<F, PointMath<F>>(p.kind, x[i], y[i]);
  });
  sum = block_sum(sum);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    map_points(__grid_constant__ PointwiseMap<T> const p, int64_t pieces, bool packed) {
  using F = Compute<T>;
  PointLoss const kind = p.kind;
  int64_t const row = blockIdx.x / pieces;
  F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
  for_each_pack(p.pair, row, blockIdx.x - row * pieces, packed, [&](int64_t e, auto const& x, auto const& y) {
    constexpr int P = sizeof(x) / sizeof(F);
    F result[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      if (p.grad || p.grad_of_sum)
        result[i] =
            point_slope<F, PointMath<F>>(kind, p.by_other, x[i], y[i]) * (p.grad ? read(p.grad[e + i]) : of_row);
      else
        result[i] = point_loss<F, PointMath<F>>(kind, x[i], y[i]);
    }
    store_pack(p.out + e, result);
  });
}

}  // namespace

template <class T>
int pointwise_sum(PointwiseSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  sum_points<<<unsigned(rows * p.pieces), kSumThreads, 0, stream>>>(p, is_packed(p.pair, nullptr));
  return add_up(p.partial, rows, p.pieces, p.sums, stream, p.finish);
}

template <class T>
int pointwise_map(PointwiseMap<T> const& p, CUstream_st* stream) {
  int64_t const pieces = ceil_div(p.pair.size, kPointPiece);
  map_points<<<unsigned(p.pair.rows * pieces), kSumThreads, 0, stream>>>(p, pieces, is_packed(p.pair, p.out));
  return cudaGetLastError();
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::cuda
