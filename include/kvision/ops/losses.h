// Losses. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

inline variable_list binary_focal_gradients(Backward const& b);
inline variable_list hausdorff_gradients(Backward const& b);
inline variable_list lovasz_gradients(Backward const& b);
inline variable_list mutual_information_gradients(Backward const& b);
inline variable_list overlap_gradients(Backward const& b);
inline variable_list focal_gradients(Backward const& b);
inline variable_list smoothness_gradients(Backward const& b);
inline variable_list total_variation_gradients(Backward const& b);

}  // namespace detail

// --- losses/binary_focal_op.cpp

inline constexpr Operator<"binary_focal",
                          Tensor(Tensor pred, Tensor target, OptionalTensor yes, OptionalTensor no, double of_yes,
                                 double of_no, double gamma, double ignored, bool ignores, bool summed)>
    binary_focal{Rule{detail::binary_focal_gradients}};

// --- losses/hausdorff_op.cpp

inline constexpr Operator<"hausdorff", Tensor(Tensor pred, Tensor target, double alpha, int64_t k, bool summed)>
    hausdorff{Rule{detail::hausdorff_gradients}};

// --- losses/lovasz_op.cpp

inline constexpr Operator<"lovasz", Two(Tensor pred, Tensor target, bool hinge)> lovasz{
    Rule{detail::lovasz_gradients, 1}};

// --- losses/mutual_information_op.cpp

inline constexpr Operator<"mutual_information",
                          Three(Tensor input, Tensor other, OptionalTensor input_mask, OptionalTensor other_mask,
                                int64_t kernel, int64_t bins, double radius, bool normalized)>
    mutual_information{Rule{detail::mutual_information_gradients, 2}};

// --- losses/segmentation_op.cpp

inline constexpr Operator<"overlap", Two(Tensor pred, Tensor target, OptionalTensor weight, bool micro, double alpha,
                                         double beta, double eps, int64_t ignored, bool ignores)>
    overlap{Rule{detail::overlap_gradients, 1}};
inline constexpr Operator<"focal", Tensor(Tensor pred, Tensor target, OptionalTensor weight, double first, double other,
                                          double gamma, int64_t ignored, bool ignores, bool summed)>
    focal{Rule{detail::focal_gradients}};

// --- losses/smoothness_op.cpp

inline constexpr Operator<"smoothness", Tensor(Tensor depth, Tensor image, double along_y, double along_x)> smoothness{
    Rule{detail::smoothness_gradients}};

// --- losses/total_variation_op.cpp

inline constexpr Operator<"total_variation", Tensor(Tensor input, double along_y, double along_x)> total_variation{
    Rule{detail::total_variation_gradients}};

// --- rules

namespace detail {

inline variable_list binary_focal_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] = b.run("binary_focal_backward",
                         {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                          b.arguments[5], b.arguments[6], b.arguments[7], b.arguments[8], b.arguments[9], false},
                         no_gradient)[0];
  if (b.needs(1))
    gradients[1] = b.run("binary_focal_backward",
                         {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                          b.arguments[5], b.arguments[6], b.arguments[7], b.arguments[8], b.arguments[9], true},
                         no_gradient)[0];
  return gradients;
}

inline variable_list hausdorff_gradients(Backward const& b) {
  return b.run("hausdorff_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

inline variable_list lovasz_gradients(Backward const& b) {
  return b.run("lovasz_backward", {b.grads[0], b.results[0], b.arguments[0], b.arguments[1], b.arguments[2]},
               no_gradient);
}

inline variable_list mutual_information_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] = b.run("mutual_information_backward",
                         {b.grads[0], b.results[0], b.results[1], b.arguments[0], b.arguments[1], b.arguments[2],
                          b.arguments[3], b.arguments[4], b.arguments[5], b.arguments[6], b.arguments[7], false},
                         no_gradient)[0];
  if (b.needs(1))
    gradients[1] = b.run("mutual_information_backward",
                         {b.grads[0], b.results[0], b.results[1], b.arguments[0], b.arguments[1], b.arguments[2],
                          b.arguments[3], b.arguments[4], b.arguments[5], b.arguments[6], b.arguments[7], true},
                         no_gradient)[0];
  return gradients;
}

inline variable_list overlap_gradients(Backward const& b) {
  return b.run("overlap_backward",
               {b.grads[0], b.results[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3],
                b.arguments[4], b.arguments[5], b.arguments[6], b.arguments[7], b.arguments[8]},
               no_gradient);
}

inline variable_list focal_gradients(Backward const& b) {
  return b.run("focal_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                b.arguments[5], b.arguments[6], b.arguments[7], b.arguments[8]},
               no_gradient);
}

inline variable_list smoothness_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] =
        b.run("smoothness_backward",
              {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], false}, no_gradient)[0];
  if (b.needs(1))
    gradients[1] =
        b.run("smoothness_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], true},
              no_gradient)[0];
  return gradients;
}

inline variable_list total_variation_gradients(Backward const& b) {
  return b.run("total_variation_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

}  // namespace detail

}  // namespace kvision::ops
