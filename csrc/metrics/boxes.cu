// Intersection over union of boxes on CUDA: one thread per pair, and for gradients one warp per box.
#include "boxes.h"
#include "core/launch.cuh"

namespace kv::metrics::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__device__ __forceinline__ Corners<Compute<T>> corners_of(T const* box, BoxFormat format) {
  using F = Compute<T>;
  F const four[] = {read(box[0]), read(box[1]), read(box[2]), read(box[3])};
  return {four, format};
}

template <class T>
__global__ void __launch_bounds__(kThreads) find_overlaps(__grid_constant__ BoxIou<T> const p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x, row = i / p.m, k = i - row * p.m;
  if (row >= p.batch * p.n) return;
  Corners const own = corners_of(p.a + 4 * row, p.format);
  p.result[i] = round_to<T>(own.overlap(corners_of(p.b + (row / p.n * p.m + k) * 4, p.format)));
}

template <class T>
__global__ void __launch_bounds__(kThreads) find_gradients(__grid_constant__ BoxIouBackward<T> const p) {
  using F = Compute<T>;
  int64_t const row = (blockIdx.x * int64_t(kThreads) + threadIdx.x) / 32;
  if (row >= p.batch * p.n) return;
  Corners<F> const own = corners_of(p.a + 4 * row, p.format);
  T const *const others = p.b + row / p.n * p.m * 4, *const grad = p.grad_of(row);
  F sum[4] = {};
  for (int64_t k = threadIdx.x % 32; k < p.m; k += 32)
    own.overlap_vjp(corners_of(others + 4 * k, p.format), read(grad[k * p.grad_stride]), sum);
  for (F& x : sum) x = warp_reduce(x, Sum());
  if (threadIdx.x % 32) return;
  Corners<F>::vjp(p.format, sum);
  for (int k = 0; k < 4; ++k) p.result[4 * row + k] = round_to<T>(sum[k]);
}

}  // namespace

template <class T>
int box_iou(BoxIou<T> const& p, CUstream_st* stream) {
  find_overlaps<<<unsigned(ceil_div(p.batch * p.n * p.m, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int box_iou_backward(BoxIouBackward<T> const& p, CUstream_st* stream) {
  find_gradients<<<unsigned(ceil_div(32 * p.batch * p.n, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(box_iou, BoxIou)
KV_INSTANTIATE(box_iou_backward, BoxIouBackward)

}  // namespace kv::metrics::cuda
