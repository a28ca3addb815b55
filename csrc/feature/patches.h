// Patches of local affine frames: bilinear samples of images at several scales, with the border repeated.
//
// A frame [A | c] is in pixels of the image. Sample (i, j) of its n x n patch reads the image at
//
//   A (u_j, u_i) + c     u_k = (2 k + 1) / n - 1
//
// from the coarsest level of the pyramid whose pixels are no farther apart than the samples of a patch of `window` x
// `window`: the largest l with window 2^l <= 2 sqrt|det A|. Pixel x of the image is (x + 1/2) w_l / w - 1/2 on a level
// of width w_l. A pyramid is one plane for each channel, which has the levels one after the other. A frame that is not
// finite gives a patch of zeros.
#pragma once

#include "core/isa.h"
#include "geometry/transform/taps.h"

#if defined(__CUDACC__)
#define KV_SAMPLES __device__ __forceinline__
#else
#define KV_SAMPLES KV_HD
#endif

namespace kv::feature {

constexpr int kMaxLevels = 16;

// Where the levels are in a plane.
struct PyramidShape {
  int levels;
  int heights[kMaxLevels], widths[kMaxLevels];
  int64_t offsets[kMaxLevels], size;
};

template <class T>
struct SamplePatches {
  T const* image;            // (batch, channels) planes of level 0, if the pyramid begins with level 1; else null
  T const* pyramid;          // (batch, channels, shape.size)
  Compute<T> const* frames;  // (batch, count, 2, 3)
  T* patches;                // (batch, count, channels, n, n)
  PyramidShape shape;
  int64_t batch, count;
  int channels, n;
  Compute<T> window;

  KV_HD int64_t pixels() const { return int64_t(shape.heights[0]) * shape.widths[0]; }
  // A level of the first channel of a sample, and the distance to the next channel.
  KV_HD T const* level(int64_t sample, int number) const {
    if (image && number == 0) return image + sample * channels * pixels();
    return pyramid + sample * channels * shape.size + shape.offsets[number];
  }
  KV_HD int64_t plane_stride(int number) const { return image && number == 0 ? pixels() : shape.size; }
};

// Gradients of half types are float32, because they are sums over patches. A null pointer: not requested.
template <class T>
struct SamplePatchesBackward {
  T const* grad;
  T const* pyramid;
  Compute<T> const* frames;
  Compute<T>* grad_pyramid;  // zeros, to which kernels add
  Compute<T>* grad_frames;
  PyramidShape shape;
  int64_t batch, count;
  int channels, n;
  Compute<T> window;
};

KV_KERNEL(sample_patches, SamplePatches)
KV_KERNEL(sample_patches_backward, SamplePatchesBackward)

// A frame on its level: samples are at (xx u + xy v + x, yx u + yy v + y). Level -1: the frame is not finite.
template <class F>
struct LevelFrame {
  F xx, xy, x, yx, yy, y;
  F scale_x, scale_y;  // of the level over the image
  int level, width, height;
};

template <class F>
KV_HD LevelFrame<F> level_frame(F const* laf, PyramidShape const& shape, F window) {
  LevelFrame<F> f{};
  f.level = -1;
  for (int i = 0; i < 6; ++i)
    if (!(laf[i] - laf[i] == 0)) return f;
  F const det = laf[0] * laf[4] - laf[1] * laf[3], area = 4 * (det < 0 ? -det : det);
  F threshold = 4 * window * window;
  int level = 0;
  while (level + 1 < shape.levels && area >= threshold) threshold *= 4, ++level;
  f.level = level, f.width = shape.widths[level], f.height = shape.heights[level];
  f.scale_x = F(f.width) / F(shape.widths[0]), f.scale_y = F(f.height) / F(shape.heights[0]);
  f.xx = laf[0] * f.scale_x, f.xy = laf[1] * f.scale_x, f.x = (laf[2] + F(0.5)) * f.scale_x - F(0.5);
  f.yx = laf[3] * f.scale_y, f.yy = laf[4] * f.scale_y, f.y = (laf[5] + F(0.5)) * f.scale_y - F(0.5);
  return f;
}

template <class F>
KV_HD F patch_coordinate(int k, int n) {
  return F(2 * k + 1) / F(n) - 1;
}

// The two taps of a coordinate along an axis, and the weight of the second one. Both read the same pixel outside of the
// image, so that the derivative is 0 there. NaN is outside, to the left.
template <class V, class I>
struct LinearTaps {
  I first, second;
  V t;
};
template <class F, class V>
KV_SAMPLES auto linear_taps(V x, int size) {
  V const zero{};
  x = geometry::vclamp(x, V(zero - 1), V(zero + F(size)));
  auto const whole = geometry::floor_to_int<F>(x);
  using I = decltype(geometry::floor_to_int<F>(x));
  I const none{}, last = none + (size - 1);
  return LinearTaps<V, I>{min(last, max(none, whole)), min(last, max(none, I(whole + 1))),
                          V(x - geometry::to_float<F>(whole))};
}

// The four taps of samples at (u, v) of a frame, row by row. V is F or lanes of it.
template <class F, class V>
struct BilinearTaps {
  using I = decltype(geometry::floor_to_int<F>(V{}));
  LinearTaps<V, I> x, y;
  I indices[4];  // of the pixels in their level

  KV_SAMPLES BilinearTaps(LevelFrame<F> const& f, V u, F v)
      : x(linear_taps<F>(V(u * f.xx + (f.xy * v + f.x)), f.width)),
        y(linear_taps<F>(V(u * f.yx + (f.yy * v + f.y)), f.height)),
        indices{y.first * f.width + x.first, y.first * f.width + x.second, y.second * f.width + x.first,
                y.second * f.width + x.second} {}
  KV_SAMPLES void weights(V (&w)[4]) const {
    w[0] = (1 - x.t) * (1 - y.t), w[1] = x.t * (1 - y.t), w[2] = (1 - x.t) * y.t, w[3] = x.t * y.t;
  }
  // A tap of weight 0 contributes nothing, even if it is inf or NaN.
  KV_SAMPLES V sample(V const (&values)[4]) const {
    V const zero{};
    V w[4], sum{};
    weights(w);
    for (int i = 0; i < 4; ++i) sum = sum + (w[i] == 0 ? zero : V(w[i] * values[i]));
    return sum;
  }
  // The derivatives of the sample along x and y.
  KV_SAMPLES void gradient(V const (&v)[4], V& along_x, V& along_y) const {
    along_x = (1 - y.t) * (v[1] - v[0]) + y.t * (v[3] - v[2]);
    along_y = (1 - x.t) * (v[2] - v[0]) + x.t * (v[3] - v[1]);
  }
};

// Adds to the gradient of a frame what a sample with derivatives gx, gy on its level contributes.
template <class F, class V>
KV_HD void add_frame_gradient(V (&sums)[6], V gx, V gy, V u, F v) {
  sums[0] += gx * u, sums[1] += gx * v, sums[2] += gx;
  sums[3] += gy * u, sums[4] += gy * v, sums[5] += gy;
}

}  // namespace kv::feature

#undef KV_SAMPLES
