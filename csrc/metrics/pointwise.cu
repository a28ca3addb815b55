// Elementwise losses on CUDA: one block per chunk of a row, four elements of both tensors per thread and step.
#include "pointwise.cuh"

namespace kv::metrics::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kSumThreads) sum_points(__grid_constant__ PointwiseSum<T> const p, bool vectorized) {
  using F = Compute<T>;
  sum_chunk(p.pair, blockIdx.x / p.chunks, p.chunks, vectorized, p.partial,
            [&](F x, F y) { return point_loss<F, PointMath<F>>(p.kind, x, y); });
}

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    map_points(__grid_constant__ PointwiseMap<T> const p, int64_t chunks, bool vectorized) {
  using F = Compute<T>;
  PointLoss const kind = p.kind;
  int64_t const row = blockIdx.x / chunks;
  F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
  map_chunk(p.pair, row, chunks, vectorized, p.out, [&](int64_t e, F x, F y) {
    if (!p.grad && !p.grad_of_sum) return point_loss<F, PointMath<F>>(kind, x, y);
    return point_derivative<F, PointMath<F>>(kind, p.by_other, x, y) * (p.grad ? read(p.grad[e]) : of_row);
  });
}

}  // namespace

template <class T>
int pointwise_sum(PointwiseSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  sum_points<<<unsigned(rows * p.chunks), kSumThreads, 0, stream>>>(p, is_vectorizable(p.pair, nullptr));
  return sum_chunks(p.partial, rows, p.chunks, p.sums, stream, p.finalize);
}

template <class T>
int pointwise_map(PointwiseMap<T> const& p, CUstream_st* stream) {
  int64_t const chunks = ceil_div(p.pair.size, kPointChunk);
  map_points<<<unsigned(p.pair.rows * chunks), kSumThreads, 0, stream>>>(p, chunks, is_vectorizable(p.pair, p.out));
  return cudaGetLastError();
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::metrics::cuda
