// Division that rounds up, for sizes of grids and chunks. Included by kernels, their headers and the glue.
#pragma once

#include "hd.h"

namespace kv {

// a >= 0, b > 0.
KV_HD constexpr int64_t ceil_div(int64_t a, int64_t b) { return (a + b - 1) / b; }

}  // namespace kv
