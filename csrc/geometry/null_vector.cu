// Null vectors on CUDA: a warp a problem.
#include "core/launch.cuh"
#include "null_vector.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 64;

template <int N, class T>
__global__ void __launch_bounds__(kThreads) null_vectors(NullVector<T> p) {
  int64_t const b = blockIdx.x * int64_t(kThreads / 32) + threadIdx.x / 32;
  if (b < p.batch) null_vector_of<N>(p, b, Warp{});
}

template <int N, class T>
__global__ void __launch_bounds__(kThreads) null_vectors_backward(NullVector<T> p) {
  int64_t const b = blockIdx.x * int64_t(kThreads / 32) + threadIdx.x / 32;
  if (b < p.batch) null_vector_backward_of<N>(p, b, Warp{});
}

}  // namespace

template <class T>
int null_vector(NullVector<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(p.batch, kThreads / 32));
  with_unknowns(p.n, [&](auto n) { null_vectors<decltype(n)::value><<<blocks, kThreads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int null_vector_backward(NullVector<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(p.batch, kThreads / 32));
  with_unknowns(p.n, [&](auto n) { null_vectors_backward<decltype(n)::value><<<blocks, kThreads, 0, stream>>>(p); });
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(null_vector, NullVector, double)
KV_INSTANTIATE_ONE(null_vector_backward, NullVector, double)

}  // namespace kv::cuda
