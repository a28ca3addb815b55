// Patches of local affine frames on the CPU. Compiled once per instruction set.
#include "core/lanes.h"
#include "patches.h"

namespace kv::feature::KV_ISA {
namespace {

// Calls sample(index, u, v) over a patch.
template <class F, class Call>
KV_HD void for_each_sample(int n, Call sample) {
  for (int i = 0; i < n; ++i) {
    F const v = patch_coordinate<F>(i, n);
    for (int j = 0; j < n; ++j) sample(int64_t(i) * n + j, patch_coordinate<F>(j, n), v);
  }
}

}  // namespace

// Patches [begin, end) of all images.
template <class T>
void sample_patches(SamplePatches<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const area = int64_t(p.n) * p.n;
  for (int64_t k = begin; k < end; ++k) {
    T* const out = p.patches + k * p.channels * area;
    LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
    if (f.level < 0) {
      for (int64_t i = 0; i < p.channels * area; ++i) store<1>(out + i, F(0));
      continue;
    }
    T const* const level = p.pyramid + k / p.count * p.channels * p.shape.size + p.shape.offsets[f.level];
    for_each_sample<F>(p.n, [&](int64_t i, F u, F v) {
      BilinearTaps<F> const taps(f, u, v);
      F w[4];
      taps.weights(w);
      for (int c = 0; c < p.channels; ++c) {
        T const* const plane = level + c * p.shape.size;
        F sum = 0;
        for (int t = 0; t < 4; ++t) sum += weighted_tap(w[t], load<1>(plane + taps.indices[t]));
        store<1>(out + c * area + i, sum);
      }
    });
  }
}

namespace {

// Adds the gradient of a plane's patches to it, in their order.
template <class T>
KV_HD void scatter_to_plane(SamplePatchesBackward<T> const& p, int64_t plane) {
  using F = Compute<T>;
  int64_t const area = int64_t(p.n) * p.n, b = plane / p.channels, c = plane % p.channels;
  for (int64_t k = b * p.count; k < (b + 1) * p.count; ++k) {
    LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
    if (f.level < 0) continue;
    F* const to = p.grad_pyramid + plane * p.shape.size + p.shape.offsets[f.level];
    T const* const grad = p.grad + (k * p.channels + c) * area;
    for_each_sample<F>(p.n, [&](int64_t i, F u, F v) {
      BilinearTaps<F> const taps(f, u, v);
      F w[4];
      taps.weights(w);
      F const g = load<1>(grad + i);
      for (int t = 0; t < 4; ++t) to[taps.indices[t]] += w[t] * g;
    });
  }
}

template <class T>
KV_HD void differentiate_frame(SamplePatchesBackward<T> const& p, int64_t k) {
  using F = Compute<T>;
  int64_t const area = int64_t(p.n) * p.n;
  F sums[6] = {};
  LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
  if (f.level >= 0) {
    T const* const level = p.pyramid + k / p.count * p.channels * p.shape.size + p.shape.offsets[f.level];
    T const* const grad = p.grad + k * p.channels * area;
    for_each_sample<F>(p.n, [&](int64_t i, F u, F v) {
      BilinearTaps<F> const taps(f, u, v);
      F gx = 0, gy = 0;
      for (int c = 0; c < p.channels; ++c) {
        T const* const plane = level + c * p.shape.size;
        F values[4], along_x, along_y;
        for (int t = 0; t < 4; ++t) values[t] = load<1>(plane + taps.indices[t]);
        taps.slopes(values, along_x, along_y);
        F const g = load<1>(grad + c * area + i);
        gx += g * along_x, gy += g * along_y;
      }
      add_frame_gradient(sums, gx, gy, u, v);
    });
  }
  for (int i = 0; i < 6; ++i) p.grad_frames[6 * k + i] = sums[i] * (i < 3 ? f.scale_x : f.scale_y);
}

}  // namespace

// The planes of the pyramids first, then the frames, where they are wanted.
template <class T>
void sample_patches_backward(SamplePatchesBackward<T> const& p, int64_t begin, int64_t end) {
  int64_t const planes = p.grad_pyramid ? p.batch * p.channels : 0;
  for (int64_t i = begin; i < end; ++i)
    if (i < planes)
      scatter_to_plane(p, i);
    else
      differentiate_frame(p, i - planes);
}

KV_INSTANTIATE(sample_patches, SamplePatches)
KV_INSTANTIATE(sample_patches_backward, SamplePatchesBackward)

}  // namespace kv::feature::KV_ISA
