// Losses element by element on CUDA: a block takes a piece of a row, each thread four elements of both tensors at a
// time.
#include "pointwise.cuh"

namespace kv::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kSumThreads) sum_points(__grid_constant__ PointwiseSum<T> const p, bool vectorized) {
  using F = Compute<T>;
  sum_piece(p.pair, blockIdx.x / p.pieces, p.pieces, vectorized, p.partial,
            [&](F x, F y) { return point_loss<F, PointMath<F>>(p.kind, x, y); });
}

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    map_points(__grid_constant__ PointwiseMap<T> const p, int64_t pieces, bool vectorized) {
  using F = Compute<T>;
  PointLoss const kind = p.kind;
  int64_t const row = blockIdx.x / pieces;
  F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
  map_piece(p.pair, row, pieces, vectorized, p.out, [&](int64_t e, F x, F y) {
    if (!p.grad && !p.grad_of_sum) return point_loss<F, PointMath<F>>(kind, x, y);
    return point_slope<F, PointMath<F>>(kind, p.by_other, x, y) * (p.grad ? read(p.grad[e]) : of_row);
  });
}

}  // namespace

template <class T>
int pointwise_sum(PointwiseSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  sum_points<<<unsigned(rows * p.pieces), kSumThreads, 0, stream>>>(p, is_vectorizable(p.pair, nullptr));
  return add_up(p.partial, rows, p.pieces, p.sums, stream, p.finish);
}

template <class T>
int pointwise_map(PointwiseMap<T> const& p, CUstream_st* stream) {
  int64_t const pieces = ceil_div(p.pair.size, kPointPiece);
  map_points<<<unsigned(p.pair.rows * pieces), kSumThreads, 0, stream>>>(p, pieces, is_vectorizable(p.pair, p.out));
  return cudaGetLastError();
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::cuda
