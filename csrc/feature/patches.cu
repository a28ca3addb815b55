// Patches of local affine frames on CUDA: one block for each patch. Neighboring samples read neighboring pixels, which
// the L1 cache serves. The gradient to the images adds by atomics; that to a frame is a sum in a fixed order.
#include "core/block_reduce.cuh"
#include "patches.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__global__ void __launch_bounds__(kThreads) sample_patch(__grid_constant__ SamplePatches<T> const p) {
  using F = Compute<T>;
  int64_t const k = blockIdx.x;
  int const area = p.n * p.n;
  T* const out = p.patches + k * p.channels * area;
  LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
  if (f.level < 0) {
    for (int64_t i = threadIdx.x; i < int64_t(p.channels) * area; i += kThreads) out[i] = round_to<T>(F(0));
    return;
  }
  T const* const level = p.level(k / p.count, f.level);
  int64_t const stride = p.plane_stride(f.level);
  for (int i = threadIdx.x; i < area; i += kThreads) {
    int const row = i / p.n;
    BilinearTaps<F, F> const taps(f, patch_coordinate<F>(i - row * p.n, p.n), patch_coordinate<F>(row, p.n));
    for (int c = 0; c < p.channels; ++c) {
      T const* const plane = level + c * stride;
      F values[4];
#pragma unroll
      for (int t = 0; t < 4; ++t) values[t] = read(plane[taps.indices[t]]);
      out[int64_t(c) * area + i] = round_to<T>(taps.sample(values));
    }
  }
}

template <class T, bool OfFrames>
__global__ void __launch_bounds__(kThreads) sample_patch_backward(__grid_constant__ SamplePatchesBackward<T> const p) {
  using F = Compute<T>;
  int64_t const k = blockIdx.x;
  int const area = p.n * p.n;
  LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
  F sums[6] = {};
  if (f.level >= 0) {
    int64_t const first = k / p.count * p.channels * p.shape.size + p.shape.offsets[f.level];
    T const* const grad = p.grad + k * p.channels * area;
    for (int i = threadIdx.x; i < area; i += kThreads) {
      int const row = i / p.n;
      F const u = patch_coordinate<F>(i - row * p.n, p.n), v = patch_coordinate<F>(row, p.n);
      BilinearTaps<F, F> const taps(f, u, v);
      F w[4], gx = 0, gy = 0;
      taps.weights(w);
      for (int c = 0; c < p.channels; ++c) {
        int64_t const plane = first + c * p.shape.size;
        F const g = read(grad[int64_t(c) * area + i]);
        if constexpr (OfFrames) {
          F values[4], along_x, along_y;
#pragma unroll
          for (int t = 0; t < 4; ++t) values[t] = read(p.pyramid[plane + taps.indices[t]]);
          taps.gradient(values, along_x, along_y);
          gx += g * along_x, gy += g * along_y;
        }
        if (p.grad_pyramid) {
#pragma unroll
          for (int t = 0; t < 4; ++t)
            if (w[t] != 0) atomicAdd(p.grad_pyramid + plane + taps.indices[t], w[t] * g);
        }
      }
      if constexpr (OfFrames) add_frame_gradient(sums, gx, gy, u, v);
    }
  }
  if constexpr (OfFrames) {
    block_reduce<kThreads>(sums, Sum());
    if (threadIdx.x == 0)
      for (int i = 0; i < 6; ++i) p.grad_frames[6 * k + i] = sums[i] * (i < 3 ? f.scale_x : f.scale_y);
  }
}

}  // namespace

template <class T>
int sample_patches(SamplePatches<T> const& p, CUstream_st* stream) {
  sample_patch<<<unsigned(p.batch * p.count), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int sample_patches_backward(SamplePatchesBackward<T> const& p, CUstream_st* stream) {
  auto const blocks = unsigned(p.batch * p.count);
  if (p.grad_frames)
    sample_patch_backward<T, true><<<blocks, kThreads, 0, stream>>>(p);
  else
    sample_patch_backward<T, false><<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_patches, SamplePatches)
KV_INSTANTIATE(sample_patches_backward, SamplePatchesBackward)

}  // namespace kv::feature::cuda
