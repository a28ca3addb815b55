// Triangulation on CUDA: a thread a point.
#include "core/launch.cuh"
#include "triangulate.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) triangulate_points(Triangulate<T> p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < p.batch * p.count) triangulate_of(p, i);
}

}  // namespace

template <class T>
int triangulate(Triangulate<T> const& p, CUstream_st* stream) {
  triangulate_points<T><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(triangulate, Triangulate, double)

}  // namespace kv::cuda
