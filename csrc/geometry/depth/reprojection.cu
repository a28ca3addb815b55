// Reprojections on CUDA: one thread for each sample.
#include "core/launch.cuh"
#include "geometry/depth/reprojection.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 32;

template <class T>
__global__ void __launch_bounds__(kThreads) set_all(__grid_constant__ ReprojectionParams<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) set_reprojection(p, b);
}

template <class T>
__global__ void __launch_bounds__(kThreads) differentiate_all(__grid_constant__ ReprojectionParams<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) reprojection_vjp(p, b);
}

}  // namespace

template <class T>
int reprojection(ReprojectionParams<T> const& p, CUstream_st* stream) {
  set_all<<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int reprojection_backward(ReprojectionParams<T> const& p, CUstream_st* stream) {
  differentiate_all<<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(reprojection, ReprojectionParams, double)
KV_INSTANTIATE_ONE(reprojection_backward, ReprojectionParams, double)

}  // namespace kv::geometry::cuda
