// Histogram equalisation of whole planes, as PIL does it: a whole number of pixels makes one output level, and the
// brightest bin that is not empty is left out of the count. Included by equalize_cpu.cpp, equalize.cu, equalize_op.cpp.
#pragma once

#include "core/isa.h"
#include "levels.h"

namespace kv {

// A plane with less than a pixel for every level stays as it is; `changed` is 0 for it, 1 for the others.
template <class T>
struct Equalize {
  Planes<T const> x;  // flat: a plane is a row
  Planes<T> y;
  T* changed;       // one a plane
  int32_t* counts;  // working memory, kLevels a plane, on CUDA only
};

KV_KERNEL(equalize, Equalize)

// The output level of one that `darker` pixels are below, `step` pixels making a level.
KV_HD int equalized_level(int64_t darker, int64_t step) { return int(min((darker + step / 2) / step, int64_t(255))); }

}  // namespace kv
