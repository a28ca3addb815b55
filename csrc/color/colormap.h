// Colormaps: every pixel of a channel becomes a color of a table.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::color {

template <class T>
struct Colormap {
  Planes<T const> x;  // a plane is a channel
  Planes<T> y;        // three planes for each of x
  T const* white;     // (B, C): the value that shows the last color
  T const* colors;    // red, green and blue of n colors
  int n;
  int64_t image_stride, channels;  // between the tables of two images; 0 for one table

  KV_HD T const* table(int64_t plane) const { return colors + plane / channels * image_stride; }
};

KV_KERNEL(apply_colormap, Colormap)

// The index of the color of a value among n colors: the first for 0, the last for 1; values in between are divided
// evenly among all colors but the last. NaN gives the first.
template <class F>
KV_HD int color_index(F v, int n) {
  if (v >= F(1)) return n - 1;
  F const position = v * F(n > 2 ? n - 2 : 1);
  if (!(position > F(0))) return 0;
  int const lower = int(position);
  return min(lower + (F(lower) < position), n - 1);
}

}  // namespace kv::color
