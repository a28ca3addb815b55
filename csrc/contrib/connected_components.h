// Connected components of masks, 8-connected: each pixel that is 1 gets 1 + the index of its component's first pixel in
// the plane, all others 0. Union-find runs in the labels themselves: the label of a pixel is its parent, a pixel of the
// component that is not later; a root is its own parent.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::contrib {

template <class T>
struct ConnectedComponents {
  Planes<T const> x;
  int64_t* labels;  // of all planes, contiguous
};

KV_KERNEL(connected_components, ConnectedComponents)

}  // namespace kv::contrib
