// Window sums, at a cost that hardly depends on the window's size: box blur, the Laplacian, and their transposes.
// Nothing is ever subtracted from a sum. A running sum that subtracts what leaves its window would carry a NaN, an
// infinity, or the rounding error of a large value to the end of the row.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"
#include "filters/separable.h"

namespace kv::filters {

// y = (sum of x over the ky x kx window + center * x) / divisor.
template <class T>
struct Box {
  Planes<T const> x;
  Planes<T> y;
  int64_t ky, kx;
  Border border;
  Compute<T> center, divisor;

  KV_HD void select(int64_t) {}
};

template <class T>
struct BoxList : FilterList<Box<T>, T> {};

KV_KERNEL(box, Box)
KV_KERNEL(box_backward, Box)
KV_KERNEL(box_list, BoxList)
KV_KERNEL(box_list_backward, BoxList)
namespace cuda {
// Means of 3 x 3 and 5 x 5 bytes in planes; false for all others.
bool box_of_bytes(Box<uint8_t> const&, CUstream_st*);
}  // namespace cuda

// One axis of the sum. Pixel i sums the positions i - before ... i + after. Positions out of bounds follow `border`.
//
// The transpose of a window sum is a window sum, except near the border. Let A be the forward sum.
//   constant, circular   The reversed window: `before` and `after` are exchanged.
//   reflect, odd sizes   D^-1 A D, where D doubles the first and the last pixel. All other pixels near the border are
//                        read at one position in bounds and at one out of bounds, so A is symmetric except for these.
//   all others           The reversed window over zeros. The `edge` pixels at either end instead gather the sums that
//                        read them, as often as read_count says.
struct BoxAxis {
  int64_t size, before, after;
  Border border;
  int64_t edge;  // pixels at either end that are not a plain window sum
  bool doubled;  // they count twice as sources and half as results

  KV_HD BoxAxis(int64_t k, int64_t n, Border rule, bool transposed)
      : size(n), before((k - 1) / 2), after(k / 2), border(rule), edge(0), doubled(false) {
    if (!transposed || k == 1) return;
    before = k / 2;
    after = (k - 1) / 2;
    doubled = rule == Border::reflect && before == after;
    edge = doubled || rule == Border::replicate ? 1 : rule == Border::reflect ? k / 2 + 1 : 0;
    if (edge > 0 && !doubled) border = Border::constant;
  }
  KV_HD int64_t count() const { return before + after + 1; }
  KV_HD bool is_edge(int64_t i) const { return i < edge || i >= size - edge; }
  KV_HD bool gathers() const { return edge > 0 && !doubled; }
};

// How often the window [r - before, r + after] of a forward sum reads pixel j of n.
KV_HD int64_t read_count(Border border, int64_t r, int64_t j, int64_t n, int64_t before, int64_t after) {
  int64_t const low = r - before, high = r + after;
  if (border == Border::replicate)
    return max(int64_t(0), (j == n - 1 ? high : min(high, j)) - (j == 0 ? low : max(low, j)) + 1);
  int64_t count = low <= j && j <= high;
  if (border == Border::reflect) count += (j > 0 && low <= -j) + (j < n - 1 && 2 * (n - 1) - j <= high);
  if (border == Border::circular) count += (low <= j - n) + (j + n <= high);
  return count;
}

}  // namespace kv::filters
