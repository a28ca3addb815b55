// Drops of rain on a lens, where a layer is above a threshold: their depth, which grows with the distance from their
// outlines, and their relief, lit from a corner. corruption/drops.py of kvision.augmentation defines them.
#pragma once

#include "core/isa.h"

namespace kv::augmentation {

// Layers (B, 1, H, W), dense.
template <class T>
struct Drops {
  T const* layer;
  T const* thresholds;  // (B or 1)
  int64_t batch, height, width, threshold_stride;

  KV_HD bool is_inside(int64_t b, int64_t at) const { return level(b, at) > 0; }
  // The level of a drop, 0 to 255, at an element of the layer of a sample. NaN stays.
  KV_HD T level(int64_t b, int64_t at) const {
    T x = layer[b * height * width + at];
    if (x < thresholds[b * threshold_stride]) x = 0;
    x = (x < 0 ? T(0) : x > 1 ? T(1) : x) * 255;
    return x == x ? T(int(x)) : x;
  }
};

// The distance to the nearest pixel of an outline, below kFarFromOutline, its mean over 3 x 3 pixels, and the floor of
// it.
constexpr int kFarFromOutline = 20;
template <class T>
struct DropDepths {
  Drops<T> drops;
  uint8_t* y;
};

template <class T>
struct DropReliefs {
  Drops<T> drops;
  uint8_t const* depths;  // equalized
  T* y;
};

KV_KERNEL(drop_depths, DropDepths)
KV_KERNEL(drop_reliefs, DropReliefs)

// Index i of a side, from -1 to its size, reflected at the outermost pixels.
KV_HD int reflected(int i, int size) {
  int const inside = i < 0 ? -i : i < size ? i : 2 * size - 2 - i;
  return clamp(inside, 0, size - 1);
}

// Sums of 3 x 3 numbers, rows first, in one order everywhere.
template <class F, class At>
KV_HD F sum_of_nine(At const& at) {
  F const above = (at(-1, -1) + at(-1, 0)) + at(-1, 1), here = (at(0, -1) + at(0, 0)) + at(0, 1),
          below = (at(1, -1) + at(1, 0)) + at(1, 1);
  return (above + here) + below;
}

// Depths lit from the upper left corner, at(row, column) relative to the pixel.
template <class At>
KV_HD int lit(At const& at) {
  int const light = 2 * (at(1, 1) - at(-1, -1)) + at(0, 0) + at(1, 0) + at(0, 1) - at(-1, 0) - at(0, -1);
  return clamp(light, 0, 255);
}

// The nearest whole number to sum / 9, which is never halfway between two.
KV_HD int rounded_ninth(int sum) { return (2 * sum + 9) / 18; }

}  // namespace kv::augmentation
