// Morphology. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

inline variable_list dilation_gradients(Backward const& b);

}  // namespace detail

// --- morphology/dilation_op.cpp

inline constexpr Operator<"dilation", Tensor(Tensor input, Tensor kernel, OptionalTensor heights, int64_t top,
                                             int64_t left, double value, bool erode)>
    dilation{Rule{detail::dilation_gradients}};

// --- rules

namespace detail {

inline variable_list dilation_gradients(Backward const& b) {
  return b.run("dilation_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                b.arguments[5], b.arguments[6]},
               no_gradient);
}

}  // namespace detail

}  // namespace kvision::ops
