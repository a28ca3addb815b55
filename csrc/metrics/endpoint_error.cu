// Endpoint errors on CUDA: one block per chunk of a row.
#include "core/row_sums.cuh"
#include "endpoint_error.h"

namespace kv::metrics::cuda {
namespace {

// Calls f(vector, its difference) for the flow vectors of the block's chunk that the thread processes.
template <class T, class Call>
__device__ __forceinline__ void for_each_difference(VectorPairs<T> const& p, int64_t row, int64_t chunk, Call f) {
  int64_t const first = chunk * kEndpointChunk, last = min(first + kEndpointChunk, p.size);
  T const *const x = p.x + row * p.x_stride, *const y = p.y + row * p.y_stride;
#pragma unroll 4
  for (int64_t i = first + threadIdx.x; i < last; i += kSumThreads) {
    int64_t const at = p.at(i), other = at + p.adjacent();
    f(i, read(x[at]) - read(y[at]), read(x[other]) - read(y[other]));
  }
}

template <class T>
__global__ void __launch_bounds__(kSumThreads) find_endpoint_errors(__grid_constant__ EndpointError<T> const p) {
  using F = Compute<T>;
  int64_t const chunks = p.pairs.chunks(), row = blockIdx.x / chunks;
  F sum = 0;
  for_each_difference(p.pairs, row, blockIdx.x - row * chunks, [&](int64_t i, F u, F v) {
    F const error = fast_sqrt(u * u + v * v);
    if (p.map)
      p.map[row * p.pairs.size + i] = round_to<T>(error);
    else
      sum += error;
  });
  if (p.map) return;
  sum = block_sum<kSumThreads>(sum);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T>
__global__ void __launch_bounds__(kSumThreads)
    find_endpoint_gradients(__grid_constant__ EndpointErrorBackward<T> const p) {
  using F = Compute<T>;
  int64_t const chunks = p.pairs.chunks(), row = blockIdx.x / chunks;
  F const of_row = p.grad ? F(0) : p.grad_of_sum[row] * p.factor;
  for_each_difference(p.pairs, row, blockIdx.x - row * chunks, [&](int64_t i, F u, F v) {
    F const error = fast_sqrt(u * u + v * v), g = p.grad ? read(p.grad[row * p.pairs.size + i]) : of_row;
    F const scale = error == 0 ? F(0) : g / error;
    T* const to = p.grad_x + 2 * row * p.pairs.size + p.pairs.at(i);
    to[0] = round_to<T>(u * scale), to[p.pairs.adjacent()] = round_to<T>(v * scale);
  });
}

}  // namespace

template <class T>
int endpoint_error(EndpointError<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pairs.rows, chunks = p.pairs.chunks();
  find_endpoint_errors<<<unsigned(rows * chunks), kSumThreads, 0, stream>>>(p);
  return p.map ? cudaGetLastError() : sum_chunks(p.partial, rows, chunks, p.sums, stream, p.finalize);
}

template <class T>
int endpoint_error_backward(EndpointErrorBackward<T> const& p, CUstream_st* stream) {
  find_endpoint_gradients<<<unsigned(p.pairs.rows * p.pairs.chunks()), kSumThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(endpoint_error, EndpointError)
KV_INSTANTIATE(endpoint_error_backward, EndpointErrorBackward)

}  // namespace kv::metrics::cuda
