// Null vectors on CUDA: one block for each problem.
#include "core/launch.cuh"
#include "geometry/solvers/null_vector.h"

namespace kv::geometry::cuda {
namespace {

template <int N, class T>
__global__ void __launch_bounds__(kMaxThreads) null_vectors(NullVector<T> p) {
  solve_null_vector<N>(p, blockIdx.x, ThreadBlock{});
}

template <int N, class T>
__global__ void __launch_bounds__(kMaxThreads) null_vectors_backward(NullVector<T> p) {
  null_vector_vjp<N>(p, blockIdx.x, ThreadBlock{});
}

// One thread for each block: the matrices of more threads do not fit into L1.
template <int N, class T>
__global__ void __launch_bounds__(1) all_eigenvectors(Eigenvectors<T> p) {
  solve_eigenvectors<N>(p, blockIdx.x);
}

}  // namespace

template <class T>
int null_vector(NullVector<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = block_size(p.m);
  dispatch_unknowns(p.n, [&](auto n) { null_vectors<decltype(n)::value><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int null_vector_backward(NullVector<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = block_size(p.m);
  dispatch_unknowns(p.n, [&](auto n) { null_vectors_backward<decltype(n)::value><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int eigenvectors(Eigenvectors<T> const& p, CUstream_st* stream) {
  dispatch_unknowns(p.n, [&](auto n) { all_eigenvectors<decltype(n)::value><<<unsigned(p.batch), 1, 0, stream>>>(p); });
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(null_vector, NullVector, double)
KV_INSTANTIATE_ONE(null_vector_backward, NullVector, double)
KV_INSTANTIATE_ONE(eigenvectors, Eigenvectors, double)

}  // namespace kv::geometry::cuda
