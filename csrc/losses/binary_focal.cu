// Binary focal loss on CUDA.
#include "binary_focal.h"
#include "metrics/pointwise.cuh"

namespace kv::losses::cuda {

using namespace metrics::cuda;

namespace {

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    sum_binary_focal(__grid_constant__ BinaryFocalSum<T> const p, bool vectorized) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / p.chunks;
  BinaryFocalTerms<F> const terms = p.terms.of(row);
  sum_chunk(p.pair, row, p.chunks, vectorized, p.partial,
            [&](F x, F t) { return BinaryFocalPoint<F, PointMath<F>, F>(terms, x).loss(t); });
}

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    map_binary_focal(__grid_constant__ BinaryFocalMap<T> const p, int64_t chunks, bool vectorized) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / chunks;
  BinaryFocalTerms<F> const terms = p.terms.of(row);
  F const of_row = p.grad_of_sum ? p.grad_of_sum[row] : F(1);
  map_chunk(p.pair, row, chunks, vectorized, p.out, [&](int64_t e, F x, F t) {
    BinaryFocalPoint<F, PointMath<F>, F> const at(terms, x);
    if (!p.grad && !p.grad_of_sum) return at.loss(t);
    return (p.by_target ? at.target_derivative(t) : at.derivative(t)) * (p.grad ? read(p.grad[e]) : of_row);
  });
}

}  // namespace

template <class T>
int binary_focal_sum(BinaryFocalSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  sum_binary_focal<<<unsigned(rows * p.chunks), kSumThreads, 0, stream>>>(p, is_vectorizable(p.pair, nullptr));
  return sum_chunks(p.partial, rows, p.chunks, p.sums, stream);
}

template <class T>
int binary_focal_map(BinaryFocalMap<T> const& p, CUstream_st* stream) {
  int64_t const chunks = point_chunks(p.pair.size);
  map_binary_focal<<<unsigned(p.pair.rows * chunks), kSumThreads, 0, stream>>>(p, chunks,
                                                                               is_vectorizable(p.pair, p.out));
  return cudaGetLastError();
}

KV_INSTANTIATE(binary_focal_sum, BinaryFocalSum)
KV_INSTANTIATE(binary_focal_map, BinaryFocalMap)

}  // namespace kv::losses::cuda
