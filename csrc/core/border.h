// Border rules of stencils: which pixel is read for a position out of bounds, and the transpose of that rule.
//
//   constant   0 0 | a b c d | 0 0
//   reflect    c b | a b c d | c b     the edge pixel is not repeated; the border has fewer pixels than the axis
//   replicate  a a | a b c d | d d
//   circular   c d | a b c d | a b     the border has at most as many pixels as the axis
//
// Forward passes ask border_index for the pixel at a position. Backward passes gather: for_each_reader lists the
// positions that read a pixel, and the pixel sums their gradients. There are no atomics, so every run gives the same
// bits.
#pragma once

#include "hd.h"

namespace kv {

// The numbers are stable: operators take them, and exported graphs contain them.
enum class Border : int { constant = 0, reflect = 1, replicate = 2, circular = 3 };

// The pixel at position i of an axis of n pixels, or -1 for the constant 0. It reflects or repeats once on each side:
// the operators refuse wider borders.
template <class Int>
KV_HD Int border_index(Border border, Int i, Int n) {
  if (i >= 0 && i < n) return i;
  switch (border) {
    case Border::reflect:
      i = i < 0 ? -i : 2 * (n - 1) - i;
      break;
    case Border::circular:
      i = i < 0 ? i + n : i - n;
      break;
    case Border::replicate:
      break;
    case Border::constant:
      return -1;
  }
  return clamp(i, Int(0), n - 1);  // memory safety, should a caller pass a wider border
}

// Calls f(i) for every position i in [-before, n + after) that reads pixel j of n, j itself first.
template <class Int, class F>
KV_HD void for_each_reader(Border border, Int j, Int n, Int before, Int after, F f) {
  f(j);
  switch (border) {
    case Border::reflect:
      if (j > 0 && j <= before) f(-j);
      if (j < n - 1 && n - 1 - j <= after) f(2 * (n - 1) - j);
      break;
    case Border::circular:
      if (n - j <= before) f(j - n);
      if (j < after) f(j + n);
      break;
    case Border::replicate:
      if (j == 0)
        for (Int i = 1; i <= before; ++i) f(-i);
      if (j == n - 1)
        for (Int i = 0; i < after; ++i) f(n + i);
      break;
    case Border::constant:
      break;
  }
}

}  // namespace kv
