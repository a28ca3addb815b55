// Lenses on CUDA: a thread a point.
#include "core/launch.cuh"
#include "undistort.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;

template <class T, bool There>
__global__ void __launch_bounds__(kThreads) through_lens(Undistort<T> p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= p.batch * p.count) return;
  T x = p.points[2 * i], y = p.points[2 * i + 1];
  Lens<T> const lens(p, i / p.count);
  There ? lens.distort(x, y) : lens.undistort(x, y);
  p.result[2 * i] = x, p.result[2 * i + 1] = y;
}

}  // namespace

template <class T>
int undistort(Undistort<T> const& p, CUstream_st* stream) {
  through_lens<T, false><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int distort(Undistort<T> const& p, CUstream_st* stream) {
  through_lens<T, true><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(undistort, Undistort)
KV_INSTANTIATE_COMPUTED(distort, Undistort)

}  // namespace kv::cuda
