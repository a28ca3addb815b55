// Images whitened by snow, behind flakes and the same flakes turned by half a circle. corruption/snow.py of
// kvision.augmentation defines them.
#pragma once

#include "color/luma.h"
#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

template <class T>
struct AddSnow {
  using F = Compute<T>;
  T const* x;
  T* y;
  int64_t batch, channels, height, width;
  int64_t x_strides[4], y_strides[4];  // of sample, channel, row and pixel
  F const* flakes;                     // (B, height, width)
  F weight;                            // of images; the rest is bright gray
  F full_range, scale;                 // 255 for bytes, 1 for floats; its inverse

  KV_HD int64_t pixels() const { return height * width; }
  // The brightness of pixel i of a sample by flakes, rounded to steps of 1 / 255.
  KV_HD F snow(int64_t b, int64_t i) const {
    F const *const own = flakes + b * pixels(), *const turned = own + pixels() - 1;
    return (rounded(own[i] * 255) + rounded(turned[-i] * 255)) / 255;
  }
#if defined(__CUDACC__)
  static KV_HD float rounded(float x) { return ::rintf(x); }
  static KV_HD double rounded(double x) { return ::rint(x); }
#else
  static KV_HD float rounded(float x) { return __builtin_rintf(x); }
  static KV_HD double rounded(double x) { return __builtin_rint(x); }
#endif
  KV_HD F within(F x) const { return x < 0 ? F(0) : x > 1 ? F(1) : x; }  // NaN stays
  // The channels of a pixel at `from`, to where `store(c, value)` puts them.
  template <class Load, class Store>
  KV_HD void whiten(T const* from, F snow, Load const& load, Store const& store) const {
    F gray = 0;
    F const each = 1 / F(channels);
    for (int c = 0; c < int(channels); ++c) {
      F const luma = c == 0 ? F(kLumaRed) : c == 1 ? F(kLumaGreen) : F(kLumaBlue);
      gray += load(from[c * x_strides[1]]) * scale * (channels == 3 ? luma : each);
    }
    F const bright = (1 - weight) * (F(1.5) * gray + F(0.5));
    for (int c = 0; c < int(channels); ++c) {
      F const v = load(from[c * x_strides[1]]) * scale, white = weight * v + bright;
      store(c, full_range * within(within(v >= white ? v : white) + snow));
    }
  }
};

// An image of a list, without gaps between its rows, its result and its flakes.
struct ListedSnow {
  void const* x;
  void* y;
  void const* flakes;
  int height, width;
  int first;  // of its items
};

// `all` is what the samples have in common. Those that are not chosen are copied.
template <class T>
struct AddSnowList {
  AddSnow<T> all;
  int count, items;
  bool interleaved;
  float const* chosen;  // (B,), 0 for samples that are not chosen; null: all are
  int64_t chosen_stride;
  ListedSnow listed[kMaxListed];

  KV_HD bool copies(int b) const { return chosen && chosen[b * chosen_stride] == 0; }
  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return listed[i].first; });
  }
  KV_HD AddSnow<T> sample(int b) const {
    ListedSnow const& own = listed[b];
    AddSnow<T> one = all;
    one.x = static_cast<T const*>(own.x), one.y = static_cast<T*>(own.y);
    one.flakes = static_cast<Compute<T> const*>(own.flakes);
    one.batch = 1, one.height = own.height, one.width = own.width;
    int64_t const width = own.width, channels = all.channels,
                  strides[] = {0, interleaved ? 1 : own.height * width, interleaved ? width * channels : width,
                               interleaved ? channels : 1};
    for (int i = 0; i < 4; ++i) one.x_strides[i] = one.y_strides[i] = strides[i];
    return one;
  }
};

KV_KERNEL(add_snow, AddSnow)
KV_KERNEL(add_snow_list, AddSnowList)

}  // namespace kv::augmentation
