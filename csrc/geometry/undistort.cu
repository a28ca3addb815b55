// Undistortion on CUDA: a thread a point.
#include "core/launch.cuh"
#include "undistort.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) undistort_points(Undistort<T> p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= p.batch * p.count) return;
  T x = p.points[2 * i], y = p.points[2 * i + 1];
  undistort_of(p, i / p.count, x, y);
  p.result[2 * i] = x, p.result[2 * i + 1] = y;
}

}  // namespace

template <class T>
int undistort(Undistort<T> const& p, CUstream_st* stream) {
  undistort_points<T><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(undistort, Undistort)

}  // namespace kv::cuda
