// Extraction of windows of images to a tensor (B, N, C, height, width), row by row, with zeros out of bounds; and its
// transpose, the sum of all patches at their positions.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::contrib {

struct PatchGrid {
  int64_t channels;
  int down, across, height, width, step_y, step_x, top, left;  // top, left: padding before the image

  // The row of patches that has row y of plane p, in row i of the grid.
  KV_HD int64_t row(int64_t p, int64_t i, int64_t j, int64_t y) const {
    int64_t const sample = p / channels, c = p - sample * channels;
    return (((sample * down + i) * across + j) * channels + c) * height + y - (i * step_y - top);
  }
  // The first and the last patch along an axis that have pixel x.
  KV_HD static int first(int x, int size, int step) { return x < size ? 0 : (x - size) / step + 1; }
  KV_HD static int last(int x, int step, int count) { return min(x / step, count - 1); }
};

template <class T>
struct Extract {
  Planes<T const> image;
  T* patches;
  PatchGrid grid;
};

template <class T>
struct Combine {
  T const* patches;
  Planes<T> image;
  PatchGrid grid;
};

KV_KERNEL(extract_patches, Extract)
KV_KERNEL(combine_patches, Combine)

}  // namespace kv::contrib
