// Binary focal loss on CUDA.
#include "binary_focal.h"
#include "metrics/pointwise.cuh"

namespace kv::losses::cuda {

using namespace metrics::cuda;

namespace {

template <class T, int P>
__global__ void __launch_bounds__(kSumThreads) sum_binary_focal(__grid_constant__ BinaryFocalSum<T> const p) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / p.chunks;
  BinaryFocalTerms<F> const terms = p.terms.of(row);
  sum_chunk<P>(p.pair, row, p.chunks, p.partial,
               [&](F x, F t) { return BinaryFocalPoint<F, PointMath<F>, F>(terms, x).loss(t); });
}

template <class T, int P>
__global__ void __launch_bounds__(kSumThreads)
    map_binary_focal(__grid_constant__ BinaryFocalMap<T> const p, int64_t chunks) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / chunks;
  BinaryFocalTerms<F> const terms = p.terms.of(row);
  F const of_row = p.grad_of_sum ? p.grad_of_sum[row] : F(1);
  map_chunk<P>(p.pair, row, chunks, p.out, [&](int64_t e, F x, F t) {
    BinaryFocalPoint<F, PointMath<F>, F> const at(terms, x);
    if (!p.grad && !p.grad_of_sum) return at.loss(t);
    return (p.by_target ? at.target_derivative(t) : at.derivative(t)) * (p.grad ? read(p.grad[e]) : of_row);
  });
}

}  // namespace

template <class T>
int binary_focal_sum(BinaryFocalSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  with_row_vectors<kVectorSize<T>>(are_equally_aligned<T>(p.pair, nullptr), [&](auto size) {
    sum_binary_focal<T, size.value><<<unsigned(rows * p.chunks), kSumThreads, 0, stream>>>(p);
  });
  return sum_chunks(p.partial, rows, p.chunks, p.sums, stream);
}

template <class T>
int binary_focal_map(BinaryFocalMap<T> const& p, CUstream_st* stream) {
  int64_t const chunks = point_chunks(p.pair.size);
  with_row_vectors<kVectorSize<T>>(are_equally_aligned<T>(p.pair, p.out), [&](auto size) {
    map_binary_focal<T, size.value><<<unsigned(p.pair.rows * chunks), kSumThreads, 0, stream>>>(p, chunks);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(binary_focal_sum, BinaryFocalSum)
KV_INSTANTIATE(binary_focal_map, BinaryFocalMap)

}  // namespace kv::losses::cuda
