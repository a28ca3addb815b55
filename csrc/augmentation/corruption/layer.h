// Images behind a layer: x (a + b m) + c m + d, where m is the layer; x and the result are clamped to [0, 1].
// corruption/layer.py of kvision.augmentation defines them.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::augmentation {

template <class T>
struct AddLayer {
  using F = Compute<T>;
  T const* x;
  T* y;
  int64_t batch, channels, height, width;
  int64_t x_strides[4], y_strides[4];  // of sample, channel, row and pixel
  F const* layer;                      // (N, C or 1, h, w)
  int64_t layers, layer_height, layer_width, layer_strides[4];
  int64_t const* windows;  // (B, 3): of each sample the layer, and the first row and column; null: its own, from 0, 0
  F const* factors;        // (B or 1, C or 1, 4): a, b, c, d
  int64_t factor_strides[2];  // of sample and channel
  F full_range;               // 255 for bytes, 1 for floats

  // The layer of a sample, from its first row and column on. Windows stay within the layers.
  KV_HD F const* layer_of(int64_t b) const {
    if (!windows) return layer + (layers > 1 ? b : 0) * layer_strides[0];
    int64_t const* const w = windows + 3 * b;
    int64_t const own = clamp(w[0], int64_t(0), layers - 1), top = clamp(w[1], int64_t(0), layer_height - height),
                  left = clamp(w[2], int64_t(0), layer_width - width);
    return layer + own * layer_strides[0] + top * layer_strides[2] + left * layer_strides[3];
  }
};

// The four factors of a channel of a sample.
template <class F>
struct LayerFactors {
  F a, b, c, d, most;

  template <class T>
  KV_HD LayerFactors(AddLayer<T> const& p, int64_t sample, int64_t channel) : most(p.full_range) {
    F const* const from = p.factors + sample * p.factor_strides[0] + channel * p.factor_strides[1];
    a = from[0], b = from[1], c = from[2] * most, d = from[3] * most;
  }
  KV_HD F behind(F x, F m) const { return within(within(x) * (a + b * m) + (c * m + d)); }
  KV_HD F within(F x) const { return x < 0 ? F(0) : x > most ? most : x; }  // NaN stays
};

KV_KERNEL(add_layer, AddLayer)

}  // namespace kv::augmentation
