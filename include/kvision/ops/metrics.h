// Metrics and what losses share with them. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/metrics.h"

namespace kvision::ops {

namespace detail {

inline variable_list pointwise_loss_gradients(Backward const& b);
inline variable_list pointwise_sum_gradients(Backward const& b);

}  // namespace detail

// --- metrics/boxes_op.cpp

// Either set of boxes may have a batch of one that serves all of the other's.
inline constexpr Operator<"box_iou", Tensor(Tensor boxes, Tensor others, int64_t format)> box_iou{
    detail::rules::box_iou};

// --- metrics/confusion_matrix_op.cpp

inline constexpr Operator<"confusion_matrix",
                          Tensor(Tensor pred, Tensor target, int64_t classes, int64_t statistic, double eps)>
    confusion_matrix{non_differentiable};

// --- metrics/endpoint_error_op.cpp

inline constexpr Operator<"endpoint_error",
                          Tensor(Tensor input, Tensor target, bool planar, bool summed, double factor)>
    endpoint_error{detail::rules::endpoint_error};

// --- metrics/pointwise_op.cpp

inline constexpr Operator<"pointwise_loss", Tensor(Tensor input, Tensor other, int64_t kind)> pointwise_loss{
    Rule{detail::pointwise_loss_gradients}};
inline constexpr Operator<"pointwise_sum",
                          Tensor(Tensor input, Tensor other, int64_t kind, double factor, double decibels)>
    pointwise_sum{Rule{detail::pointwise_sum_gradients, 1}};

// --- metrics/ssim_op.cpp

inline constexpr Operator<"ssim", Tensor(Tensor input, Tensor other, int64_t size, double sigma, double c1, double c2,
                                         double eps, int64_t padding, bool luminance)>
    ssim{detail::rules::ssim};
inline constexpr Operator<"ssim_loss",
                          Tensor(Tensor input, Tensor other, int64_t size, double sigma, double c1, double c2,
                                 double eps, int64_t padding, double structure, double absolute)>
    ssim_loss{detail::rules::ssim_loss};
inline constexpr Operator<"ms_ssim", Tensor(Tensor input, Tensor other, Floats sigmas, int64_t size, double c1,
                                            double c2, double structure, double absolute)>
    ms_ssim{detail::rules::ms_ssim};

// --- rules

namespace detail {

inline variable_list pointwise_loss_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] = b.run("pointwise_loss_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], false},
                         no_gradient)[0];
  if (b.needs(1))
    gradients[1] = b.run("pointwise_loss_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], true},
                         no_gradient)[0];
  return gradients;
}

inline variable_list pointwise_sum_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] = b.run("pointwise_sum_backward",
                         {b.grads[0], b.results[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3],
                          b.arguments[4], false},
                         no_gradient)[0];
  if (b.needs(1))
    gradients[1] = b.run("pointwise_sum_backward",
                         {b.grads[0], b.results[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3],
                          b.arguments[4], true},
                         no_gradient)[0];
  return gradients;
}

}  // namespace detail

}  // namespace kvision::ops
