// Morphology. Arguments are those of torch.ops.kvision.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

inline constexpr Operator<"dilation", Tensor(Tensor input, Tensor kernel, OptionalTensor heights, int64_t top,
                                             int64_t left, double value, bool erode)>
    dilation{from<"dilation_backward">};

}  // namespace kvision::ops
