// The derivative of the absolute value. Included by the kernels of losses of absolute differences.
#pragma once

#include "core/hd.h"

namespace kv::losses {

// 0 at 0; NaN stays NaN.
template <class V>
KV_HD V sign_of(V d) {
  return d > 0 ? V{} + 1 : d < 0 ? V{} - 1 : d;
}

}  // namespace kv::losses
