// Images whose columns, rows or both are reversed, and windows of images: copies of pixels, and zeros where there are
// none. The transpose of a flip is itself, that of a window the one that shows its pixels where they came from.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct Flip {
  Planes<T const> x;
  Planes<T> y;
  bool columns, rows;         // reversed
  int64_t top = 0, left = 0;  // the place in x, which is not reversed then, of the first pixel of y
};

KV_KERNEL(flip, Flip)

}  // namespace kv
