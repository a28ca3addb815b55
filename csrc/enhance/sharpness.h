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
};

// The gradients of images of different sizes. Those of images that are not chosen are copies of what is given.
constexpr int kMaxListedGradients = kMaxListed / 2;  // tables have an image more for each sample
template <class T>
struct SharpnessBackwardList {
  SharpnessBackward<T> all;  // without images
  int count, items, channels;
  bool interleaved;
  float const* chosen;  // (B,), 0 for samples that are not chosen; null: all are
  int64_t chosen_stride;
  ListedImage images[kMaxListedGradients], grads[kMaxListedGradients];
  ListedResult results[kMaxListedGradients];
  int first[kMaxListedGradients];

  KV_HD bool copies(int b) const { return chosen && chosen[b * chosen_stride] == 0; }
  KV_HD int end_of(int b) const { return b + 1 < count ? first[b + 1] : items; }
  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
  // With a plane for each channel.
  KV_HD SharpnessBackward<T> sample(int b) const {
    SharpnessBackward<T> one = all;
    if (one.factor.data) one.factor.data += b * one.factor.of_image;
    one.x = channels_of(images_of<T>(images[b], channels));
    one.grad = channels_of(images_of<T>(grads[b], channels));
    one.grad_x = channels_of(images_of<T>(results[b], channels, interleaved));
    return one;
  }
  template <class U>
  static KV_HD Planes<U> channels_of(Images<U> const& x) {
    return {x.data, x.channels, 1, x.channel_stride, 0, x.row_stride, x.height, x.width, x.step};
  }
};

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
