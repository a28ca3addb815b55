// Real roots on CUDA: one thread for each polynomial.
#include "core/launch.cuh"
#include "geometry/solvers/roots.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 64;

template <class T>
__global__ void __launch_bounds__(kThreads) solve_polynomials(RealRoots<T> p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) sorted_real_roots(p, b);
}

template <class T>
__global__ void __launch_bounds__(kThreads) find_first_roots(RealRoots<T> p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) set_first_root(p, b);
}

}  // namespace

template <class T>
int real_roots(RealRoots<T> const& p, CUstream_st* stream) {
  solve_polynomials<T><<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int first_root(RealRoots<T> const& p, CUstream_st* stream) {
  find_first_roots<T><<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(real_roots, RealRoots, double)
KV_INSTANTIATE_ONE(first_root, RealRoots, double)

}  // namespace kv::geometry::cuda
