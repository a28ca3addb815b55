// Images whose columns, rows or both are reversed, or neither: then a copy. The transpose of each is itself.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct Flip {
  Planes<T const> x;
  Planes<T> y;
  bool columns, rows;
};

KV_KERNEL(flip, Flip)

}  // namespace kv
