// Objects of masks that are dropped: every object has a random rank, and those of the highest ranks are dropped.
// occlusion/objects.py of kvision.augmentation defines it.
#pragma once

#include "core/isa.h"

namespace kv::augmentation {

// T is the type of masks, int64.
template <class T>
struct DropObjects {
  T const *values, *components;  // (B, N, pixels); those of the regions of one mask a sample, or null
  float const *words, *counts;   // (B,), whole numbers: the source of the ranks, and how many objects are dropped
  int64_t const* widths;         // (B,) of images that are padded on the right to `width`, or null
  uint8_t* y;                    // (B, pixels)
  int64_t batch, masks, pixels, width;
  int most;  // count that is obeyed

  // The lowest 32 bits of a number as others, as `mixed_words` of draws.py.
  static KV_HD uint32_t mixed(uint32_t x) {
    x = (x ^ (x >> 16)) * 0x7FEB352Du;
    x = (x ^ (x >> 15)) * 0x846CA68Bu;
    return x ^ (x >> 16);
  }
  // Those of the elements of a sample, of `pixels` for each mask; -1 where there is no object.
  struct Ranks {
    T const *values, *components;
    int64_t pixels;
    uint32_t word;
    int width, padding;

    // The number of the region at element i, which has this value, if there is one.
    KV_HD T number(int64_t i, T value) const { return value != 0 && components ? components[i] : 0; }
    KV_HD int64_t rank(int64_t i, T value, T number) const {
      if (value == 0) return -1;
      uint32_t const object = components ? region(number) + mixed(uint32_t(value)) : uint32_t(i / pixels);
      return mixed(object ^ word);
    }
    KV_HD int64_t operator()(int64_t i) const { return rank(i, values[i], number(i, values[i])); }
    // The number of a region, which is one more than its first pixel, in the image without its padding.
    KV_HD uint32_t region(T number) const {
      return uint32_t(number) - (padding == 0 ? 0 : uint32_t((int(number) - 1) / width * padding));
    }
  };
  KV_HD Ranks ranks(int64_t b) const {
    return {values + b * masks * pixels,
            components ? components + b * pixels : nullptr,
            pixels,
            mixed(uint32_t(words[b])),
            int(width),
            int(widths ? width - widths[b] : 0)};
  }
  KV_HD int count(int64_t b) const { return int(min(counts[b], float(most))); }
  // What stands for all ranks being below it.
  static constexpr int64_t kNone = int64_t(1) << 32;
};

KV_KERNEL(drop_objects, DropObjects)

}  // namespace kv::augmentation
