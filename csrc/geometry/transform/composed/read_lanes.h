// How walks read the displacements of a vector of pixels. Included by *_cpu.cpp files.
#pragma once

#include "core/lanes.h"
// After core/lanes.h, whose vectors it uses.
#include "geometry/transform/composed/composed_warp.h"

namespace kv::geometry {

// Reads elements of a plane one by one, because gather instructions are slower on many processors.
struct ReadLanes {
  template <class F, class I>
  KV_HD auto operator()(F const* plane, I at) const {
    constexpr int N = sizeof(I) / sizeof(int);
    if constexpr (N == 1) {
      return plane[at];
    } else {
      Lanes<F, N> v;
      for (int i = 0; i < N; ++i) v[i] = plane[at[i]];
      return v;
    }
  }
};

}  // namespace kv::geometry
