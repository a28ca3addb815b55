// Images behind a layer: x (a + b m) + c m + d, where m is the layer; x and the result are clamped to [0, 1].
// corruption/layer.py of kvision.augmentation defines them.
#pragma once

#include "core/isa.h"
#include "core/stencils/filter_list.h"
#include "core/stencils/gradient_list.h"
#include "core/view.h"

namespace kv::augmentation {

template <class T>
struct AddLayer {
  using F = Compute<T>;
  Planes<T const> x;
  Planes<T> y;
  int64_t channels;
  F const* layer;  // (N, C or 1, h, w)
  int64_t layers, layer_height, layer_width, layer_strides[4];
  int64_t const* windows;  // (B, 3): of each sample the layer, and the first row and column; null: its own, from 0, 0
  F const* factors;        // (B or 1, C or 1, 4): a, b, c, d
  int64_t factor_strides[2];  // of sample and channel
  F full_range;               // 255 for bytes, 1 for floats

  // Rows of channels-last images have all channels of their pixels.
  KV_HD int64_t planes_per_sample() const { return x.step > 1 ? 1 : channels; }
  // The row of a channel, from which pixels are x.step elements apart.
  template <class U>
  KV_HD U* row(Planes<U> const& images, int64_t b, int64_t c, int64_t row) const {
    return x.step > 1 ? images.row(b, row) + c : images.row(b * channels + c, row);
  }
  // The layer of a sample, from its first row and column on. Windows stay within the layers.
  KV_HD F const* layer_of(int64_t b) const {
    if (!windows) return layer + (layers > 1 ? b : 0) * layer_strides[0];
    int64_t const* const w = windows + 3 * b;
    int64_t const own = clamp(w[0], int64_t(0), layers - 1), top = clamp(w[1], int64_t(0), layer_height - x.height),
                  left = clamp(w[2], int64_t(0), layer_width - x.width);
    return layer + own * layer_strides[0] + top * layer_strides[2] + left * layer_strides[3];
  }
  // The layer of an image alone, which is in a block of memory from `begin` on and has the size of the image.
  KV_HD void select_packed(int64_t begin) { layer += begin, layers = 1, layer_strides[2] = x.width; }
  KV_HD void select(int64_t b) {
    if (windows)
      windows += 3 * b;
    else if (layers > 1)
      layer += b * layer_strides[0];
    factors += b * factor_strides[0];
  }
};

// Where the layers of a list are packed: (1, H, W) of the size of each image, one after the other, each at a multiple
// of kLayerUnit numbers. The parameters of a kernel have room for those of every second one.
constexpr int kLayerUnit = 16;
template <int Count>
struct PackedLayers {
  bool are_packed;
  uint32_t begin[Count / 2];  // in units

  KV_HD static int64_t units(int64_t height, int64_t width) { return (height * width + kLayerUnit - 1) / kLayerUnit; }
  KV_HD int64_t begin_of(int b, ListedImage const* images) const {
    int64_t const before = b % 2 ? units(images[b - 1].height, images[b - 1].width) : 0;
    return kLayerUnit * (begin[b / 2] + before);
  }
};

// Layers of lists are packed, or as large as the largest image; then each image has the upper left part, or a window.
template <class T>
struct AddLayerList : FilterList<AddLayer<T>, T> {
  PackedLayers<kMaxListed> packed;

  KV_HD AddLayer<T> sample(int b) const {
    AddLayer<T> one = FilterList<AddLayer<T>, T>::sample(b);
    if (packed.are_packed) one.select_packed(packed.begin_of(b, this->list.images));
    return one;
  }
};

// The gradients of images, whose planes are channels in any layout.
template <class T>
struct AddLayerBackward : AddLayer<T> {
  Planes<T const> grad;
  Planes<T> grad_x;
};
template <class T, class Gradient = AddLayerBackward<T>>
struct AddLayerBackwardList : GradientList<Gradient, T> {
  PackedLayers<kMaxListedGradients> packed;

  KV_HD Gradient sample(int b) const {
    Gradient one = GradientList<Gradient, T>::sample(b);
    if (packed.are_packed) one.select_packed(packed.begin_of(b, this->images));
    return one;
  }
};

// The four factors of a channel of a sample.
template <class F>
struct LayerFactors {
  F a, b, c, d, most;

  KV_HD LayerFactors(F const* from, F most)
      : a(from[0]), b(from[1]), c(from[2] * most), d(from[3] * most), most(most) {}
  template <class T>
  KV_HD LayerFactors(AddLayer<T> const& p, int64_t sample, int64_t channel)
      : LayerFactors(p.factors + sample * p.factor_strides[0] + channel * p.factor_strides[1], p.full_range) {}
  KV_HD F behind(F x, F m) const { return within(before_clamp(x, m)); }
  // The gradient of x, which is 0 where x or the result is clamped.
  KV_HD F vjp(F x, F m, F g) const { return is_clamped(x) || is_clamped(before_clamp(x, m)) ? F(0) : g * (a + b * m); }
  // That of a number on which the factors depend with these slopes.
  KV_HD F vjp_of_factors(LayerFactors const& slopes, F x, F m, F g) const {
    return is_clamped(before_clamp(x, m)) ? F(0) : g * slopes.before_clamp(x, m);
  }
  KV_HD F before_clamp(F x, F m) const { return within(x) * (a + b * m) + (c * m + d); }
  KV_HD bool is_clamped(F x) const { return x < 0 || x > most; }
  KV_HD F within(F x) const { return x < 0 ? F(0) : x > most ? most : x; }  // NaN stays
};

// The factors of fog of the images of a list, each with its largest value, and their slopes along this value.
// corruption/fog.py defines them.
template <class T>
struct FogFactors {
  using F = Compute<T>;
  F const *brightest, *numbers;  // (B,) of at least 0; (B or 1, 3): the amount, and the range of the layer
  F *factors, *slopes;           // (B, 1, 4)
  int64_t count, number_stride;
  F full_range;

  KV_HD void find(int64_t b) const {
    F const *const own = numbers + b * number_stride, most = brightest[b];
    F const amount = own[0], low = own[1], least = F(1e-12);
    F const inside = (most > full_range ? full_range : most) / full_range, sum = inside + amount, range = own[2] - low;
    F const divisor = sum < least ? least : sum, darker = inside / divisor;
    F const clouds = darker * amount / (range < least ? least : range);
    set(factors + 4 * b, darker, clouds, low);
    F const slope = most > full_range ? F(0) : (1 - (sum < least ? F(0) : darker)) / divisor;
    set(slopes + 4 * b, slope, slope * amount / (range < least ? least : range), low);
  }
  static KV_HD void set(F* to, F darker, F clouds, F low) {
    to[0] = darker, to[1] = 0, to[2] = clouds, to[3] = -low * clouds;
  }
};

// The gradients of images behind fog, whose pixels of the largest value share that of the factors.
template <class T>
struct FogBackward : AddLayerBackward<T> {
  Compute<T> const *slopes, *brightest;

  KV_HD void select(int64_t b) {
    slopes += b * this->factor_strides[0], brightest += b;
    AddLayer<T>::select(b);
  }
};
// On the CPU an item is an image, on CUDA a part of one.
constexpr int kFogPixels = 4096;
template <class T>
struct FogBackwardList : AddLayerBackwardList<T, FogBackward<T>> {
  double* sums;  // of each item: the gradient of the factors, and how many pixels have the largest value
};

KV_KERNEL(add_layer, AddLayer)
KV_KERNEL(add_layer_list, AddLayerList)
KV_KERNEL(add_layer_list_backward, AddLayerBackwardList)
KV_KERNEL(fog_factors, FogFactors)
KV_KERNEL(fog_list_backward, FogBackwardList)

}  // namespace kv::augmentation
