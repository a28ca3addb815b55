// Flips, which reverse columns, rows or both, and crops of images. Pixels out of bounds are 0. The backward pass of a
// flip is the flip; that of a crop is the crop by the opposite corner.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::geometry {

template <class T>
struct Flip {
  Planes<T const> x;
  Planes<T> y;
  bool columns, rows;         // reversed
  int64_t top = 0, left = 0;  // of a crop: the position in x of the first pixel of y; neither axis is reversed then
};

KV_KERNEL(flip, Flip)

}  // namespace kv::geometry
