// Lens distortion on CUDA. A thread maps one point; for the gradient of a map, a block sums over a chunk of its pixels.
#include "core/block_reduce.cuh"
#include "geometry/calibration/distortion.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 128;

// Pixels of an image, which has fewer than 2^31.
template <class T>
__device__ __forceinline__ void pixel_at(LensPoints<T> const& p, unsigned i, T& x, T& y) {
  unsigned const row = i / unsigned(p.width);
  x = T(i - row * unsigned(p.width));
  y = T(row);
}

template <class T, bool Distorts>
__global__ void __launch_bounds__(kThreads) through_lens(LensPoints<T> p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= p.batch * p.count) return;
  int64_t const b = i / p.count;
  T x, y;
  if (p.points)
    x = p.points[2 * i], y = p.points[2 * i + 1];
  else
    pixel_at(p, unsigned(i - b * p.count), x, y);
  Lens<T> const lens(p, b);
  Domain<T> const domain(lens.c);
  if constexpr (!Distorts)
    lens.undistort(x, y, domain);
  else
    p.points ? lens.distort(x, y) : lens.distort_within(x, y, domain);
  int64_t const to = p.points ? 2 * i : i + b * p.count;
  p.result[to] = x, p.result[to + (p.points ? 1 : p.count)] = y;
}

template <class T>
__global__ void __launch_bounds__(kThreads) undistort_map_backward_parts(__grid_constant__ LensBackward<T> const p) {
  int64_t const b = blockIdx.x / p.parts, part = blockIdx.x - b * p.parts;
  int64_t const last = min(p.count, (part + 1) * kLensChunk);
  T const* const grad = p.grad + 2 * b * p.count;
  Lens<T> const lens(p, b);
  T sums[kLensSums] = {};
#pragma unroll 1
  for (int64_t i = part * kLensChunk + threadIdx.x; i < last; i += kThreads) {
    T x, y;
    pixel_at(p, unsigned(i), x, y);
    lens.accumulate_grads(x, y, grad[i], grad[p.count + i], sums);
  }
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * kLensSums);
}

// One warp per sample.
template <class T>
__global__ void sum_parts(LensBackward<T> p) {
  int64_t const b = blockIdx.x;
  int const i = int(threadIdx.x);
  if (i == kLensSums) p.set_zeros(b);
  if (i >= kLensSums) return;
  double sum = 0;
  for (int64_t part = b * p.parts; part < (b + 1) * p.parts; ++part) sum += p.sums[part * kLensSums + i];
  p.set(b, i, sum);
}

}  // namespace

template <class T>
int undistort_points(LensPoints<T> const& p, CUstream_st* stream) {
  through_lens<T, false><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int distort_points(LensPoints<T> const& p, CUstream_st* stream) {
  through_lens<T, true><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int undistort_map_backward(LensBackward<T> const& p, CUstream_st* stream) {
  undistort_map_backward_parts<<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int reduce_lens_grads(LensBackward<T> const& p, CUstream_st* stream) {
  sum_parts<<<unsigned(p.batch), 32, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(undistort_points, LensPoints)
KV_INSTANTIATE_COMPUTED(distort_points, LensPoints)
KV_INSTANTIATE_COMPUTED(undistort_map_backward, LensBackward)
KV_INSTANTIATE_COMPUTED(reduce_lens_grads, LensBackward)

}  // namespace kv::geometry::cuda
