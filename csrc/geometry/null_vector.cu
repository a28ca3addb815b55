// Null vectors on CUDA: a block a problem.
#include "core/launch.cuh"
#include "null_vector.h"

namespace kv::cuda {
namespace {

template <int N, class T>
__global__ void __launch_bounds__(kMostThreads) null_vectors(NullVector<T> p) {
  null_vector_of<N>(p, blockIdx.x, Block{});
}

template <int N, class T>
__global__ void __launch_bounds__(kMostThreads) null_vectors_backward(NullVector<T> p) {
  null_vector_backward_of<N>(p, blockIdx.x, Block{});
}

}  // namespace

template <class T>
int null_vector(NullVector<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = team_size(p.m);
  with_unknowns(p.n, [&](auto n) { null_vectors<decltype(n)::value><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int null_vector_backward(NullVector<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = team_size(p.m);
  with_unknowns(p.n, [&](auto n) { null_vectors_backward<decltype(n)::value><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(null_vector, NullVector, double)
KV_INSTANTIATE_ONE(null_vector_backward, NullVector, double)

}  // namespace kv::cuda
