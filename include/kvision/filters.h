// The filters. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/filters
// explains, and a gradient to every tensor. Images are (B, C, H, W), kernel sizes ky, kx, and `border` is one of
// "constant", "reflect", "replicate", "circular".
#pragma once

#include "kvision/operator.h"

namespace kvision {

inline Tensor sobel_backward(Tensor const& grad, Tensor const& input, bool normalized, double eps) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"sobel_backward">(grad, input, normalized, eps)}; };
  return differentiable({grad, input}, compute, {}, no_second_derivative("sobel"))[0];
}

inline Tensor sobel(Tensor const& input, bool normalized = true, double eps = 1e-6) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"sobel">(input, normalized, eps)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{sobel_backward(b.grads[0], b.saved[0], normalized, eps)};
  };
  return differentiable({input}, compute, {input}, gradient)[0];
}

}  // namespace kvision
