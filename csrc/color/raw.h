// Demosaicing of Bayer pictures, linearly between the nearest pixels of each colour. Included by raw_cpu.cpp, raw.cu
// and raw_op.cpp.
//
// A row has green and one other colour, its own: red or blue. With the border that mirrors the mosaic, its neighbours
// above and below have green and the opposite colour.
//
//   at a pixel of the row's colour     own: itself                      green: mean of the four beside   opposite: of
//   the diagonals at a green pixel                   own: mean of left and right      green: itself opposite: of above
//   and below
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct RawToRgb {
  Planes<T const> raw;
  Planes<T> rgb;    // three planes an image
  int row, column;  // of the red pixel among two by two

  // The plane of the row's own colour, 0 or 2, and the parity of its columns.
  KV_HD int own(int64_t y) const { return y % 2 == row ? 0 : 2; }
  KV_HD int phase(int64_t y) const { return y % 2 == row ? column : 1 - column; }
};
template <class T>
struct RawToRgbBackward {
  RawToRgb<T> forward;  // without data; its sizes are those of both
  Planes<T const> grad;
  Planes<T> grad_raw;
};

KV_KERNEL(raw_to_rgb, RawToRgb)
KV_KERNEL(raw_to_rgb_backward, RawToRgbBackward)

// What stands beside pixel i of n, whose border mirrors.
KV_HD int64_t mirrored(int64_t i, int64_t n) { return i < 0 ? -i : i < n ? i : 2 * (n - 1) - i; }
// How often pixel i of n is the neighbour of the one before it, or after it, in its transpose: the outermost pixel sees
// its only neighbour twice.
KV_HD int times(int64_t neighbour, int64_t n) {
  return neighbour < 0 || neighbour >= n ? 0 : neighbour == 0 || neighbour == n - 1 ? 2 : 1;
}

// Of pixels with these neighbours.
template <class V>
struct Demosaiced {
  V at_own[3], at_green[3];  // own, green, opposite

  KV_HD Demosaiced(V const (&above)[3], V const (&beside)[3], V const (&below)[3]) {
    V const across = (beside[0] + beside[2]) * 0.5f, down = (above[1] + below[1]) * 0.5f;
    V const corners = ((above[0] + above[2]) + (below[0] + below[2])) * 0.25f;
    at_own[0] = at_green[1] = beside[1];
    at_own[1] = (across + down) * 0.5f;
    at_own[2] = corners;
    at_green[0] = across;
    at_green[2] = down;
  }
};

// The transpose: the gradient of a pixel of the row's colour from the gradients of that colour around it, or of a green
// pixel from those of green. Rows and columns count as often as `times` has them.
template <class V, class S>
KV_HD V gathered(bool own, V const (&above)[3], V const (&beside)[3], V const (&below)[3], S up, S down, S left,
                 S right) {
  V const middle = beside[1] + (above[1] * up + below[1] * down) * (own ? S(0.5) : S(0.25));
  if (!own) return middle + (beside[0] * left + beside[2] * right) * S(0.25);
  V const before = beside[0] + (above[0] * up + below[0] * down) * S(0.5);
  V const after = beside[2] + (above[2] * up + below[2] * down) * S(0.5);
  return middle + (before * left + after * right) * S(0.5);
}

}  // namespace kv
