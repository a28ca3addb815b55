// Local maxima and minima of images or volumes: elements that are above, or below, all others of their window. The
// window reaches (k - 1) / 2 elements back and k / 2 ahead along an axis. Where it crosses the border there is no
// maximum. NaN is neither above nor below anything.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::geometry {

template <class T>
struct Nms {
  Planes<T const> x;
  Planes<T> y;                     // x at the maxima, 0 elsewhere; no data if not requested
  Planes<uint8_t> maxima, minima;  // whether an element is one; no data if not requested
  int64_t depth;                   // planes of a volume, 1 for an image
  int before[3], after[3];         // how far the window reaches along z, y, x

  // The columns [first, last) of a row whose windows are inside; none if the window crosses the border along z or y.
  KV_HD void fitting(int64_t plane, int64_t row, int64_t& first, int64_t& last) const {
    int64_t const z = depth > 1 ? plane % depth : 0;
    bool const fits = z >= before[0] && z < depth - after[0] && row >= before[1] && row < x.height - after[1];
    last = fits ? max(x.width - after[2], int64_t(0)) : 0;
    first = min(int64_t(before[2]), last);
  }
};

// Keeps the elements whose flags are not 0, and sets the others to 0: the gradient of maxima. Contiguous.
template <class T>
struct ApplyNmsMask {
  T const* x;
  uint8_t const* flags;
  T* result;
  int64_t count;
};

KV_KERNEL(nms, Nms)
KV_KERNEL(apply_nms_mask, ApplyNmsMask)

}  // namespace kv::geometry
