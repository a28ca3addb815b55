// The derivative of an absolute value. Included by losses of absolute differences.
#pragma once

#include "core/hd.h"

namespace kv {

// 0 at 0; NaN stays.
template <class V>
KV_HD V sign_of(V d) {
  return d > 0 ? V{} + 1 : d < 0 ? V{} - 1 : d;
}

}  // namespace kv
