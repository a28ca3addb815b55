// Morphology. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/morphology
// explains, and gradients. Images are (B, C, H, W). A second derivative is an error.
#pragma once

#include <ATen/TensorOperators.h>

#include <cmath>

#include "kvision/operator.h"

namespace kvision {

inline Tensor dilation_backward(Tensor const& grad, Tensor const& input, Tensor const& offsets, int64_t top,
                                int64_t left, double value, bool erode) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"dilation_backward">(grad, input, offsets, top, left, value, erode)};
  };
  return differentiable({grad, input, offsets}, compute, {}, no_second_derivative("dilation"))[0];
}

// The largest of input(q + (i - top, j - left)) + offsets(i, j), or with `erode` the smallest of input(...) -
// offsets(i, j); `value` is what lies outside. offsets (B or 1, height, width), minus infinity for what is no member.
// The gradient is that of the image.
inline Tensor dilation(Tensor const& input, Tensor const& offsets, int64_t top, int64_t left, double value = -INFINITY,
                       bool erode = false) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"dilation">(input, offsets, top, left, value, erode)}; };
  auto const gradient = [=](Backward const& b) {
    TORCH_CHECK_NOT_IMPLEMENTED(!b.wanted(1), "dilation: C++ has no gradient of offsets; Python's kvision has");
    return variable_list{dilation_backward(b.grads[0], b.saved[0], b.saved[1], top, left, value, erode), {}};
  };
  return differentiable({input, offsets}, compute, {input, offsets}, gradient)[0];
}

}  // namespace kvision
