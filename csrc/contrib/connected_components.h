// Connected regions of masks, corners included: every pixel that is 1 gets 1 + the index of its region's first pixel in
// the plane, every other 0. Union-find in the labels themselves: while it runs a label leads to a pixel of the region
// that is no later, and a root to itself. Included by connected_components_cpu.cpp, .cu and _op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct ConnectedComponents {
  Planes<T const> x;
  int64_t* labels;  // of all planes, one behind the other
};

KV_KERNEL(connected_components, ConnectedComponents)

}  // namespace kv
