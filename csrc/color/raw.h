// Bilinear demosaicing of Bayer images.
//
// A row has green pixels and pixels of one other color, red or blue, called the row's color. The rows above and below
// have green and the opposite color, also at the border, which reflects the mosaic.
//
//                                  row's color              green                    opposite color
//   at a pixel of the row's color  the pixel                mean of four neighbors   mean of the diagonals
//   at a green pixel               mean of left and right   the pixel                mean of above and below
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::color {

template <class T>
struct RawToRgb {
  Planes<T const> raw;
  Planes<T> rgb;    // three planes per image
  int row, column;  // of the red pixel in a cell of 2 x 2

  // The plane of the row's color, 0 or 2, and the parity of the columns that have it.
  KV_HD int row_color(int64_t y) const { return y % 2 == row ? 0 : 2; }
  KV_HD int phase(int64_t y) const { return y % 2 == row ? column : 1 - column; }
};
template <class T>
struct RawToRgbBackward {
  RawToRgb<T> forward;  // sizes and the filter array alone, without data
  Planes<T const> grad;
  Planes<T> grad_raw;
};

KV_KERNEL(raw_to_rgb, RawToRgb)
KV_KERNEL(raw_to_rgb_backward, RawToRgbBackward)

// The index of pixel i of n with a reflected border.
KV_HD int64_t reflected(int64_t i, int64_t n) { return i < 0 ? -i : i < n ? i : 2 * (n - 1) - i; }
// How often a pixel next to `neighbor` reads it: an outermost pixel reads its only neighbor twice.
KV_HD int reader_count(int64_t neighbor, int64_t n) {
  return neighbor < 0 || neighbor >= n ? 0 : neighbor == 0 || neighbor == n - 1 ? 2 : 1;
}

// The colors of a pixel from its 3 x 3 neighborhood, by the kind of the pixel.
template <class V>
struct Demosaic {
  V at_row_color[3], at_green[3];  // row's color, green, opposite color

  KV_HD Demosaic(V const (&above)[3], V const (&center)[3], V const (&below)[3]) {
    V const across = (center[0] + center[2]) * 0.5f, down = (above[1] + below[1]) * 0.5f;
    V const corners = ((above[0] + above[2]) + (below[0] + below[2])) * 0.25f;
    at_row_color[0] = at_green[1] = center[1];
    at_row_color[1] = (across + down) * 0.5f;
    at_row_color[2] = corners;
    at_green[0] = across;
    at_green[2] = down;
  }
};

// The transpose: the gradient of a pixel from the gradients of its color around it. `has_row_color` is false for green
// pixels. Rows and columns count as often as reader_count says.
template <class V, class S>
KV_HD V demosaic_vjp(bool has_row_color, V const (&above)[3], V const (&center)[3], V const (&below)[3], S up, S down,
                     S left, S right) {
  V const middle = center[1] + (above[1] * up + below[1] * down) * (has_row_color ? S(0.5) : S(0.25));
  if (!has_row_color) return middle + (center[0] * left + center[2] * right) * S(0.25);
  V const before = center[0] + (above[0] * up + below[0] * down) * S(0.5);
  V const after = center[2] + (above[2] * up + below[2] * down) * S(0.5);
  return middle + (before * left + after * right) * S(0.5);
}

}  // namespace kv::color
