// Sums over windows, at a cost that hardly depends on the window's size: box blur, the box Laplacian, and their
// transposes. Sums are only ever added to, never subtracted from: a running sum that has met a NaN or an infinity, or
// lost the low bits of a large offset, would carry that to the end of the row.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"

namespace kv {

// y = (sum of x over the ky x kx window + centre * x) / divisor.
template <class T>
struct Box {
  Planes<T const> x;
  Planes<T> y;
  int64_t ky, kx;
  Border border;
  Compute<T> centre, divisor;
};

KV_KERNEL(box, Box)
KV_KERNEL(box_backward, Box)

// One axis of the sum. Pixel i sums the positions i - before ... i + after; what lies outside follows `border`.
//
// The transpose of such a sum is one again, up to the rim. Let A be the forward sum.
//   constant, circular   The window turned round: before and after change places.
//   reflect, odd         D^-1 A D, where D doubles the first and the last pixel: every other pixel near the rim stands
//                        at one position inside and at one outside, so A is symmetric but for those two.
//   the rest             The window turned round over zeros, except for the `rim` pixels at either end, which gather
//   the
//                        sums that read them, each as often as `reads` says.
struct BoxAxis {
  int64_t size, before, after;
  Border border;
  int64_t rim;   // how many pixels at either end are not just a window sum
  bool doubled;  // they count twice as sources and half as results

  KV_HD BoxAxis(int64_t k, int64_t n, Border rule, bool transposed)
      : size(n), before((k - 1) / 2), after(k / 2), border(rule), rim(0), doubled(false) {
    if (!transposed || k == 1) return;
    before = k / 2;
    after = (k - 1) / 2;
    doubled = rule == Border::reflect && before == after;
    rim = doubled || rule == Border::replicate ? 1 : rule == Border::reflect ? k / 2 + 1 : 0;
    if (rim > 0 && !doubled) border = Border::constant;
  }
  KV_HD int64_t count() const { return before + after + 1; }
  KV_HD bool is_rim(int64_t i) const { return i < rim || i >= size - rim; }
  KV_HD bool gathers() const { return rim > 0 && !doubled; }
};

// At how many positions of the window [r - before, r + after] of a forward sum pixel j of n stands.
KV_HD int64_t reads(Border border, int64_t r, int64_t j, int64_t n, int64_t before, int64_t after) {
  int64_t const low = r - before, high = r + after;
  if (border == Border::replicate)
    return max(int64_t(0), (j == n - 1 ? high : min(high, j)) - (j == 0 ? low : max(low, j)) + 1);
  int64_t count = low <= j && j <= high;
  if (border == Border::reflect) count += (j > 0 && low <= -j) + (j < n - 1 && 2 * (n - 1) - j <= high);
  if (border == Border::circular) count += (low <= j - n) + (j + n <= high);
  return count;
}

// sum / divisor. A tie between two bytes must be one, which the product with a rounded reciprocal need not be.
template <class T, class V, class F>
KV_HD V quotient(V sum, F divisor, F reciprocal) {
  if constexpr (sizeof(T) == 1)
    return sum / divisor;
  else
    return sum * reciprocal;
}

}  // namespace kv
