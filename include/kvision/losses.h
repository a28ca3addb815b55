// Losses. Each function has the arguments of the operator torch.ops.kvision.<name>, which
// python/kvision/losses explains, and gradients to logits and images (B, C, H, W). Labels (B, H, W) are int64;
// `ignores` says whether `ignored` is one that does not count. A second derivative is an error.
#pragma once

#include <ATen/TensorOperators.h>

#include <optional>

#include "kvision/operator.h"

namespace kvision {

inline Tensor class_sums_backward(Tensor const& grad, Tensor const& pred, Tensor const& target, int64_t ignored,
                                  bool ignores) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"class_sums_backward">(grad, pred, target, ignored, ignores)}; };
  return differentiable({grad, pred}, compute, {}, no_second_derivative("class_sums"))[0];
}

// (B, 3, C): for every class the sums of its softmax probability where it is the label, of that everywhere, and of its
// pixels, of which Dice and Tversky losses are made.
inline Tensor class_sums(Tensor const& pred, Tensor const& target, int64_t ignored = -100, bool ignores = true) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"class_sums">(pred, target, ignored, ignores)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{class_sums_backward(b.grads[0], b.saved[0], b.saved[1], ignored, ignores)};
  };
  return differentiable({pred}, compute, {pred, target}, gradient)[0];
}

inline Tensor focal_backward(Tensor const& grad, Tensor const& pred, Tensor const& target,
                             std::optional<Tensor> const& weight, double first, double other, double gamma,
                             int64_t ignored, bool ignores) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"focal_backward">(grad, pred, target, weight, first, other, gamma, ignored, ignores)};
  };
  return differentiable({grad, pred}, compute, {}, no_second_derivative("focal"))[0];
}

// The focal loss of every pixel (B, H, W). `first` weighs class 0, `other` the others, and weight (1, C) all of them.
inline Tensor focal(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight = {},
                    double first = 0.5, double other = 0.5, double gamma = 2, int64_t ignored = -100,
                    bool ignores = true) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"focal">(pred, target, weight, first, other, gamma, ignored, ignores)};
  };
  auto const gradient = [=](Backward const& b) {
    return variable_list{focal_backward(b.grads[0], b.saved[0], b.saved[1],
                                        b.saved[2].defined() ? std::optional(b.saved[2]) : std::nullopt, first, other,
                                        gamma, ignored, ignores)};
  };
  return differentiable({pred}, compute, {pred, target, weight.value_or(Tensor())}, gradient)[0];
}

inline Tensor total_variation_backward(Tensor const& grad, Tensor const& input, double along_y, double along_x) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"total_variation_backward">(grad, input, along_y, along_x)}; };
  return differentiable({grad, input}, compute, {}, no_second_derivative("total_variation"))[0];
}

// (B, C): for every plane the absolute differences of neighbours, those along y and along x each summed with a weight.
inline Tensor total_variation(Tensor const& input, double along_y = 1, double along_x = 1) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"total_variation">(input, along_y, along_x)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{total_variation_backward(b.grads[0], b.saved[0], along_y, along_x)};
  };
  return differentiable({input}, compute, {input}, gradient)[0];
}

}  // namespace kvision
