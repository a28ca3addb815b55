// Drops of rain and stains on a lens, where a layer is above a threshold: the depth of drops, which grows with the
// distance from their outlines, and their relief, lit from a corner. corruption/drops.py of kvision.augmentation
// defines them.
#pragma once

#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

// Layers (B, 1, H, W), dense, which stand for their mean and their deviation times the numbers that are stored.
template <class T>
struct Drops {
  T const* layer;
  T const* parameters;  // (B or 1, 3): mean, deviation, threshold
  int64_t batch, height, width, parameter_stride;

  KV_HD T value(int64_t b, int64_t at) const {
    T const* const of = parameters + b * parameter_stride;
    return of[0] + of[1] * layer[b * height * width + at];
  }
  KV_HD T threshold(int64_t b) const { return parameters[b * parameter_stride + 2]; }
  KV_HD bool is_inside(int64_t b, int64_t at) const { return level(b, at) > 0; }
  // The level of a drop, 0 to 255, at an element of the layer of a sample. NaN stays.
  KV_HD T level(int64_t b, int64_t at) const {
    T x = value(b, at);
    if (x < threshold(b)) x = 0;
    x = (x < 0 ? T(0) : x > 1 ? T(1) : x) * 255;
    return x == x ? T(int(x)) : x;
  }
};

// A layer of a list, its depths where these are read, and its result.
struct ListedDrops {
  void const* layer;
  void const* depths;
  void* result;
  int height, width;
  int first;  // of its items: bands of rows on the CPU, tiles on CUDA
};

// The distance to the nearest pixel of an outline, below kFarFromOutline, its mean over 3 x 3 pixels, and the floor of
// it.
constexpr int kFarFromOutline = 20;
template <class T>
struct DropDepths {
  Drops<T> drops;
  uint8_t* y;

  KV_HD void place(ListedDrops const& own) { y = static_cast<uint8_t*>(own.result); }
};

template <class T>
struct DropReliefs {
  Drops<T> drops;
  uint8_t const* depths;  // equalized
  T* y;

  KV_HD void place(ListedDrops const& own) {
    depths = static_cast<uint8_t const*>(own.depths);
    y = static_cast<T*>(own.result);
  }
};

// 1 above the threshold, and 0 elsewhere.
template <class T>
struct MarkStains {
  Drops<T> drops;
  T* y;

  KV_HD void place(ListedDrops const& own) { y = static_cast<T*>(own.result); }
};

// `all` is what the layers of a list have in common.
template <class T, class Kernel>
struct DropsList {
  Kernel all;
  int count, items;
  ListedDrops listed[kMaxListed];

  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return listed[i].first; });
  }
  KV_HD Kernel sample(int b) const {
    Kernel one = all;
    ListedDrops const& own = listed[b];
    one.drops.layer = static_cast<T const*>(own.layer);
    one.drops.parameters += b * all.drops.parameter_stride;
    one.drops.batch = 1, one.drops.height = own.height, one.drops.width = own.width;
    one.place(own);
    return one;
  }
};
template <class T>
struct DropDepthsList : DropsList<T, DropDepths<T>> {};
template <class T>
struct DropReliefsList : DropsList<T, DropReliefs<T>> {};
template <class T>
struct MarkStainsList : DropsList<T, MarkStains<T>> {};

KV_KERNEL(drop_depths, DropDepths)
KV_KERNEL(drop_reliefs, DropReliefs)
KV_KERNEL(mark_stains, MarkStains)
KV_KERNEL(drop_depths_list, DropDepthsList)
KV_KERNEL(drop_reliefs_list, DropReliefsList)
KV_KERNEL(mark_stains_list, MarkStainsList)

constexpr int kDropBand = 32;  // rows of an item on the CPU

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
