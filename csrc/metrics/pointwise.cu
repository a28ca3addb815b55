// Elementwise losses on CUDA: one block per chunk of a row.
#include "pointwise.cuh"

namespace kv::metrics::cuda {
namespace {

// Calls f with the kind, as a constant for squares, those of mse and psnr, and charbonnier: without a switch at each
// element they need little more time than their memory.
template <class Call>
__device__ __forceinline__ void with_kind(PointLoss kind, Call f) {
  if (kind == PointLoss::square)
    f(std::integral_constant<PointLoss, PointLoss::square>{});
  else if (kind == PointLoss::charbonnier)
    f(std::integral_constant<PointLoss, PointLoss::charbonnier>{});
  else
    f(kind);
}

template <class T, int P>
__global__ void __launch_bounds__(kSumThreads) sum_points(__grid_constant__ PointwiseSum<T> const p) {
  using F = Compute<T>;
  with_kind(p.kind, [&](auto kind) {
    sum_chunk<P>(p.pair, blockIdx.x / p.chunks, p.chunks, p.partial,
                 [&](F x, F y) { return point_loss<F, PointMath<F>>(kind, x, y); });
  });
}

template <class T, int P>
__global__ void __launch_bounds__(kSumThreads) map_points(__grid_constant__ PointwiseMap<T> const p, int64_t chunks) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / chunks;
  F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
  with_kind(p.kind, [&](auto kind) {
    map_chunk<P>(p.pair, row, chunks, p.out, [&](int64_t e, F x, F y) {
      if (!p.grad && !p.grad_of_sum) return point_loss<F, PointMath<F>>(kind, x, y);
      return point_derivative<F, PointMath<F>>(kind, p.by_other, x, y) * (p.grad ? read(p.grad[e]) : of_row);
    });
  });
}

}  // namespace

template <class T>
int pointwise_sum(PointwiseSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  with_row_vectors<kVectorSize<T>>(are_equally_aligned<T>(p.pair, nullptr), [&](auto size) {
    sum_points<T, size.value><<<unsigned(rows * p.chunks), kSumThreads, 0, stream>>>(p);
  });
  return sum_chunks(p.partial, rows, p.chunks, p.sums, stream, p.finalize);
}

template <class T>
int pointwise_map(PointwiseMap<T> const& p, CUstream_st* stream) {
  int64_t const chunks = ceil_div(p.pair.size, kPointChunk);
  with_row_vectors<kVectorSize<T>>(are_equally_aligned<T>(p.pair, p.out), [&](auto size) {
    map_points<T, size.value><<<unsigned(p.pair.rows * chunks), kSumThreads, 0, stream>>>(p, chunks);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::metrics::cuda
