// Sharpness: an image extrapolated away from its smoothed copy s, or interpolated towards it, by a factor f:
//
//                                      | 1 1 1 |
//   y = clip(x + (x - s) (f - 1))   s = | 1 5 1 | x / 13, clipped
//                                      | 1 1 1 |
//
// The border, one pixel wide, is only clipped.
#pragma once

#include "core/ceil_div.h"
#include "core/isa.h"
#include "core/stencils/filter_list.h"
#include "core/stencils/gradient_list.h"
#include "core/view.h"
#include "plane_parameter.h"
#if defined(__CUDACC__)
#include "core/nan_min_max.cuh"
#endif

namespace kv::enhance {

template <class T>
struct Sharpness {
  Planes<T const> x;  // one plane per channel
  Planes<T> y;
  PlaneParameter<Compute<T>> factor;

  KV_HD void select(int64_t b) {
    if (factor.data) factor.data += b * factor.of_image;
  }
};
template <class T>
struct SharpnessList : FilterList<Sharpness<T>, T> {};
template <class T>
struct SharpnessBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  PlaneParameter<Compute<T>> factor;
  Compute<T>* gradients;  // of the factor: (planes, chunks); null: not needed
  int64_t chunks;

  KV_HD void select(int64_t b) {
    if (factor.data) factor.data += b * factor.of_image;
  }
};

template <class T>
struct SharpnessBackwardList : GradientList<SharpnessBackward<T>, T> {};

KV_KERNEL(sharpness, Sharpness)
KV_KERNEL(sharpness_list, SharpnessList)
KV_KERNEL(sharpness_backward, SharpnessBackward)
KV_KERNEL(sharpness_list_backward, SharpnessBackwardList)

// An image of interleaved pixels, given as one plane, with a plane for each channel.
template <class T>
KV_HD Sharpness<T> by_channels(Sharpness<T> one) {
  one.x.inner = one.y.inner = one.x.step;
  one.x.inner_stride = one.y.inner_stride = 1;
  return one;
}

// How CUDA splits a plane into chunks: strips of columns, one per warp, where pixels of a row are contiguous; otherwise
// tiles.
constexpr int kTileWidth = 64, kTileHeight = 16, kStripWidth = 128, kStripRows = 32;
template <class T>
int64_t sharpness_tiles(Planes<T> const& x) {
  int64_t const width = x.step == 1 ? kStripWidth : kTileWidth, height = x.step == 1 ? kStripRows : kTileHeight;
  return ceil_div(x.width, width) * ceil_div(x.height, height);
}

template <class V, class F>
KV_HD V smoothed(V const& sum_of_nine, V const& x, F) {
  return (sum_of_nine + x * F(4)) * F(1. / 13);
}
template <class V, class F>
KV_HD V clipped(V const& x, F) {
#if defined(__CUDA_ARCH__)
  if constexpr (sizeof(V) == sizeof(float)) return nan_min(nan_max(x, 0.f), 1.f);  // two instructions
#endif
  V const none = x * F(0);  // NaN stays NaN
  return x < F(0) ? none : x > F(1) ? none + F(1) : x;
}
// `smooth` is the result of `smoothed`.
template <class V, class F>
KV_HD V sharpened(V const& x, V const& smooth, F factor) {
  return clipped(V(x + (x - clipped(smooth, F(0))) * (factor - F(1))), F(0));
}

// The contributions of a gradient g to the pixel itself, to the pixels of its smoothing stencil, and to the factor.
template <class V>
struct SharpenedVjp {
  V own, around, factor;
};
template <class V, class F>
KV_HD SharpenedVjp<V> sharpened_vjp(V const& x, V const& smooth, V const& g, F factor) {
  V const none = g * F(0), apart = x - clipped(smooth, F(0)), y = x + apart * (factor - F(1));
  V const within = y >= F(0) ? (y <= F(1) ? g : none) : none;
  V const grad_smooth = smooth >= F(0) ? (smooth <= F(1) ? within : none) : none;
  return {within * factor, grad_smooth * (F(1) - factor), within * apart};
}
template <class V, class F>
KV_HD V clipped_vjp(V const& x, V const& g, F) {
  V const none = g * F(0);
  return x >= F(0) ? (x <= F(1) ? g : none) : none;
}

}  // namespace kv::enhance
