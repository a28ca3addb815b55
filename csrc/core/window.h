// The window of an image that a matrix maps to the result, in whole pixels, along one axis.
#pragma once

#include "hd.h"

namespace kv {

struct Window {
  int first, size;
  bool mirrored;
};

// The nearest whole number in [low, high]; `low` for NaN.
KV_HD int round_within(double x, int low, int high) { return x > double(low) ? int(min(x, double(high)) + 0.5) : low; }

// Of an axis of `from` pixels, which the matrix takes to scale x + offset, where the result has pixels 0 to `to` - 1. A
// negative scale mirrors the result.
KV_HD Window window_of(double scale, double offset, int from, int to, bool align_corners) {
  double const length = scale < 0 ? -scale : scale;
  bool const mirrored = scale < 0;
  Window window{0, 1, mirrored};
  if (align_corners) {  // the centers of the outermost pixels correspond; a single pixel of the result has one tap
    window.first = round_within(((mirrored ? to - 1 : 0) - offset) / scale, 0, from - 1);
    if (to > 1) window.size = 1 + round_within((to - 1) / length, 0, from - 1 - window.first);
  } else {
    window.first = round_within(((mirrored ? to - 0.5 : -0.5) - offset) / scale + 0.5, 0, from - 1);
    window.size = round_within(to / length, 1, from - window.first);
  }
  return window;
}

}  // namespace kv
