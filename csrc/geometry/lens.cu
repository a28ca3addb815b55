// Lenses on CUDA: a thread a point.
#include "core/launch.cuh"
#include "lens.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;

template <class T, bool There>
__global__ void __launch_bounds__(kThreads) through_lens(LensPoints<T> p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= p.batch * p.count) return;
  T x = p.points[2 * i], y = p.points[2 * i + 1];
  Lens<T> const lens(p, i / p.count);
  There ? lens.distort(x, y) : lens.undistort(x, y);
  p.result[2 * i] = x, p.result[2 * i + 1] = y;
}

}  // namespace

template <class T>
int undistort(LensPoints<T> const& p, CUstream_st* stream) {
  through_lens<T, false><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int distort(LensPoints<T> const& p, CUstream_st* stream) {
  through_lens<T, true><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(undistort, LensPoints)
KV_INSTANTIATE_COMPUTED(distort, LensPoints)

}  // namespace kv::cuda
