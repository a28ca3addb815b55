// Reprojections on CUDA: a thread a sample.
#include "core/launch.cuh"
#include "geometry/depth/reprojection.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 32;

template <class T>
__global__ void __launch_bounds__(kThreads) reprojections(__grid_constant__ Reprojections<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) reprojection_of(p, b);
}

template <class T>
__global__ void __launch_bounds__(kThreads) reprojections_backward(__grid_constant__ Reprojections<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) reprojection_vjp(p, b);
}

}  // namespace

template <class T>
int reprojection(Reprojections<T> const& p, CUstream_st* stream) {
  reprojections<<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int reprojection_backward(Reprojections<T> const& p, CUstream_st* stream) {
  reprojections_backward<<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(reprojection, Reprojections, double)
KV_INSTANTIATE_ONE(reprojection_backward, Reprojections, double)

}  // namespace kv::cuda
