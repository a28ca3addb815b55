// Gradients of metrics that are no single call.
#pragma once

#include <ATen/ExpandUtils.h>
#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops::detail::rules {

// An operator has one kernel for the gradients to both images and one for the first alone.
template <Name first, Name both>
inline constexpr Rule first_or_both{[](Backward const& b) { return b.call(b.needs(1) ? both.text : first.text); }};

inline constexpr Rule ssim{first_or_both<"ssim_backward", "ssim_backward_both">};
inline constexpr Rule ssim_loss{first_or_both<"ssim_loss_backward", "ssim_loss_backward_both">};
inline constexpr Rule ms_ssim{first_or_both<"ms_ssim_backward", "ms_ssim_backward_both">};

inline constexpr Rule endpoint_error{[](Backward const& b) -> variable_list {
  Tensor const to_input = b.call("endpoint_error_backward")[0];
  return {to_input, -to_input};
}};
// Either set of boxes may have a batch of one that serves all of the other's.
inline constexpr Rule box_iou{[](Backward const& b) -> variable_list {
  auto const to = [&](size_t i, Tensor const& grad) {
    if (!b.needs(i)) return Tensor();
    Tensor const boxes = b.tensor(i), others = b.tensor(1 - i);
    return at::sum_to(b.call("box_iou_backward", {{"grad", grad}, {"boxes", boxes}, {"others", others}})[0],
                      boxes.sizes());
  };
  return {to(0, b.grad()), to(1, b.grad().mT())};
}};

}  // namespace kvision::ops::detail::rules
