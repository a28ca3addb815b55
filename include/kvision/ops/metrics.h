// Metrics and what losses share with them. Arguments are those of torch.ops.kvision.
#pragma once

#include <ATen/ExpandUtils.h>
#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

// An operator has one kernel for the gradients to both images and one for the first alone.
template <Name first, Name both>
inline constexpr Rule first_or_both{[](Backward const& b) { return b.call(b.needs(1) ? both.text : first.text); }};

}  // namespace detail

inline constexpr Operator<"ssim", Tensor(Tensor input, Tensor other, int64_t size, double sigma, double c1, double c2,
                                         double eps, int64_t padding, bool luminance)>
    ssim{detail::first_or_both<"ssim_backward", "ssim_backward_both">};
inline constexpr Operator<"ssim_loss",
                          Tensor(Tensor input, Tensor other, int64_t size, double sigma, double c1, double c2,
                                 double eps, int64_t padding, double structure, double absolute)>
    ssim_loss{detail::first_or_both<"ssim_loss_backward", "ssim_loss_backward_both">};
inline constexpr Operator<"ms_ssim", Tensor(Tensor input, Tensor other, Floats sigmas, int64_t size, double c1,
                                            double c2, double structure, double absolute)>
    ms_ssim{detail::first_or_both<"ms_ssim_backward", "ms_ssim_backward_both">};

inline constexpr Operator<"pointwise_loss", Tensor(Tensor input, Tensor other, int64_t kind)> pointwise_loss{
    from_each<"pointwise_loss_backward", "by_other">};
inline constexpr Operator<"pointwise_sum",
                          Tensor(Tensor input, Tensor other, int64_t kind, double factor, double decibels)>
    pointwise_sum{from_each<"pointwise_sum_backward", "by_other", 1>};
inline constexpr Operator<"endpoint_error",
                          Tensor(Tensor input, Tensor target, bool planar, bool summed, double factor)>
    endpoint_error{[](Backward const& b) -> variable_list {
      Tensor const to_input = b.call("endpoint_error_backward")[0];
      return {to_input, -to_input};
    }};
inline constexpr Operator<"confusion_matrix",
                          Tensor(Tensor pred, Tensor target, int64_t classes, int64_t statistic, double eps)>
    confusion_matrix{non_differentiable};
// Either set of boxes may have a batch of one that serves all of the other's.
inline constexpr Operator<"box_iou", Tensor(Tensor boxes, Tensor others, int64_t format)> box_iou{
    [](Backward const& b) -> variable_list {
      auto const to = [&](size_t i, Tensor const& grad) {
        if (!b.needs(i)) return Tensor();
        Tensor const boxes = b.tensor(i), others = b.tensor(1 - i);
        return at::sum_to(b.call("box_iou_backward", {{"grad", grad}, {"boxes", boxes}, {"others", others}})[0],
                          boxes.sizes());
      };
      return {to(0, b.grad()), to(1, b.grad().mT())};
    }};

}  // namespace kvision::ops
