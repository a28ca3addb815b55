// Morphology. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/morphology
// explains, and gradients. Images are (B, C, H, W). A second derivative is an error.
#pragma once

#include <ATen/TensorOperators.h>

#include <cmath>
#include <optional>

#include "kvision/operator.h"

namespace kvision {

inline Tensor dilation_backward(Tensor const& grad, Tensor const& input, Tensor const& kernel,
                                std::optional<Tensor> const& heights, int64_t top, int64_t left, double value,
                                bool erode) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"dilation_backward">(grad, input, kernel, heights, top, left, value, erode)};
  };
  return differentiable({grad, input, heights.value_or(Tensor())}, compute, {}, no_second_derivative("dilation"))[0];
}

// The largest pixel under the members of a structuring element turned round, plus their heights; with `erode` the
// smallest under the element, minus their heights. Members are where kernel (B or 1, height, width) is not 0, in the
// type that images are computed in, heights as large; `value` is what lies outside. The gradient is that of the image.
inline Tensor dilation(Tensor const& input, Tensor const& kernel, std::optional<Tensor> const& heights, int64_t top,
                       int64_t left, double value = -INFINITY, bool erode = false) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"dilation">(input, kernel, heights, top, left, value, erode)}; };
  auto const gradient = [=](Backward const& b) {
    TORCH_CHECK_NOT_IMPLEMENTED(!b.wanted(1), "dilation: C++ has no gradient of heights; Python's kvision has");
    auto const saved_heights = b.saved[2].defined() ? std::optional(b.saved[2]) : std::nullopt;
    return variable_list{dilation_backward(b.grads[0], b.saved[0], b.saved[1], saved_heights, top, left, value, erode),
                         {}};
  };
  Tensor const of_heights = heights.value_or(Tensor());
  return differentiable({input, of_heights}, compute, {input, kernel, of_heights}, gradient)[0];
}

}  // namespace kvision
