// Losses. Each function has the arguments of the operator torch.ops.kvision.<name>, which
// python/kvision/losses explains, and gradients to logits (losses, B, C, H, W) and images (B, C, H, W).
// Labels (losses or 1, B, H, W) are int64; `ignores` says whether `ignored` is one that does not count. A second
// derivative is an error.
#pragma once

#include <ATen/TensorOperators.h>

#include <optional>
#include <tuple>

#include "kvision/operator.h"

namespace kvision {

inline Tensor overlap_backward(Tensor const& grad, Tensor const& sums, Tensor const& pred, Tensor const& target,
                               std::optional<Tensor> const& weight, bool together, double alpha, double beta,
                               double eps, int64_t ignored, bool ignores) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"overlap_backward">(grad, sums, pred, target, weight, together, alpha, beta, eps, ignored, ignores)};
  };
  return differentiable({grad, sums, pred}, compute, {}, no_second_derivative("overlap"))[0];
}

// Losses (losses), and of every sample the sums that they are made of, without a gradient: (losses, B, 3, C), for every
// class its softmax probability where it is the label, that everywhere, and its pixels. Dice losses have alpha and beta
// of 0.5 and half their eps, with the classes `together` or not, as Tversky losses have them.
inline std::tuple<Tensor, Tensor> overlap(Tensor const& pred, Tensor const& target,
                                          std::optional<Tensor> const& weight = {}, bool together = true,
                                          double alpha = 0.5, double beta = 0.5, double eps = 5e-9,
                                          int64_t ignored = -100, bool ignores = true) {
  using namespace detail;
  auto const compute = [&] {
    auto [loss, sums] =
        call<"overlap", std::tuple<Tensor, Tensor>>(pred, target, weight, together, alpha, beta, eps, ignored, ignores);
    return variable_list{loss, sums};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const x = b.saved[0];
    auto const of_classes = b.saved[2].defined() ? std::optional(b.saved[2]) : std::nullopt;
    Tensor const sums =
        std::get<1>(overlap(x.detach(), b.saved[1], of_classes, together, alpha, beta, eps, ignored, ignores));
    return variable_list{
        overlap_backward(b.grads[0], sums, x, b.saved[1], of_classes, together, alpha, beta, eps, ignored, ignores)};
  };
  variable_list const found = differentiable({pred}, compute, {pred, target, weight.value_or(Tensor())}, gradient);
  return {found[0], found[1].detach()};
}

inline Tensor focal_backward(Tensor const& grad, Tensor const& pred, Tensor const& target,
                             std::optional<Tensor> const& weight, double first, double other, double gamma,
                             int64_t ignored, bool ignores, bool summed) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"focal_backward">(grad, pred, target, weight, first, other, gamma, ignored, ignores, summed)};
  };
  return differentiable({grad, pred}, compute, {}, no_second_derivative("focal"))[0];
}

// The focal losses of every pixel (losses, B, H, W), or their sums (losses). `first` weighs class 0, `other` the
// others, and weight (losses or 1, C) all of them.
inline Tensor focal(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight = {},
                    double first = 0.5, double other = 0.5, double gamma = 2, int64_t ignored = -100,
                    bool ignores = true, bool summed = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"focal">(pred, target, weight, first, other, gamma, ignored, ignores, summed)};
  };
  auto const gradient = [=](Backward const& b) {
    return variable_list{focal_backward(b.grads[0], b.saved[0], b.saved[1],
                                        b.saved[2].defined() ? std::optional(b.saved[2]) : std::nullopt, first, other,
                                        gamma, ignored, ignores, summed)};
  };
  return differentiable({pred}, compute, {pred, target, weight.value_or(Tensor())}, gradient)[0];
}

inline Tensor lovasz_backward(Tensor const& grad, Tensor const& slopes, Tensor const& pred, Tensor const& target,
                              bool hinge) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"lovasz_backward">(grad, slopes, pred, target, hinge)}; };
  return differentiable({grad, slopes, pred}, compute, {}, no_second_derivative("lovasz"))[0];
}

// (B, C): the Lovász losses of every class of logits (B, C, H, W) with labels (B or 1, H, W), int64 or uint8, or the
// `hinge` losses of one class, whose label is 1; and (B, C, H, W) their slopes by the errors of the pixels, without a
// gradient.
inline std::tuple<Tensor, Tensor> lovasz(Tensor const& pred, Tensor const& target, bool hinge = false) {
  using namespace detail;
  auto const compute = [&] {
    auto [losses, slopes] = call<"lovasz", std::tuple<Tensor, Tensor>>(pred, target, hinge);
    return variable_list{losses, slopes};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const x = b.saved[0], slopes = std::get<1>(lovasz(x.detach(), b.saved[1], hinge));
    return variable_list{lovasz_backward(b.grads[0], slopes, x, b.saved[1], hinge)};
  };
  variable_list const found = differentiable({pred}, compute, {pred, target}, gradient);
  return {found[0], found[1].detach()};
}

inline Tensor hausdorff_backward(Tensor const& grad, Tensor const& pred, Tensor const& target, double alpha, int64_t k,
                                 bool summed) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"hausdorff_backward">(grad, pred, target, alpha, k, summed)}; };
  return differentiable({grad, pred}, compute, {}, no_second_derivative("hausdorff"))[0];
}

// What survives k erosions of the squared differences of probabilities (B, C, H, W) or (B, C, D, H, W), float32 or
// float64, from labels (B or 1, ...), the i-th erosion weighing i^alpha: of every pixel, or the sums (B, C).
inline Tensor hausdorff(Tensor const& pred, Tensor const& target, double alpha = 2, int64_t k = 10,
                        bool summed = false) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"hausdorff">(pred, target, alpha, k, summed)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{hausdorff_backward(b.grads[0], b.saved[0], b.saved[1], alpha, k, summed)};
  };
  return differentiable({pred}, compute, {pred, target}, gradient)[0];
}

inline Tensor binary_focal_backward(Tensor const& grad, Tensor const& pred, Tensor const& target,
                                    std::optional<Tensor> const& yes, std::optional<Tensor> const& no, double of_yes,
                                    double of_no, double gamma, double ignored, bool ignores, bool summed,
                                    bool by_target) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"binary_focal_backward">(grad, pred, target, yes, no, of_yes, of_no, gamma, ignored,
                                                       ignores, summed, by_target)};
  };
  return differentiable({grad, pred, target}, compute, {}, no_second_derivative("binary_focal"))[0];
}

// The focal losses of logits and targets (rows, size), or their sums (rows); the positive terms are multiplied by
// of_yes and those of a row by `yes` (rows), without a gradient, the negative ones likewise.
inline Tensor binary_focal(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& yes = {},
                           std::optional<Tensor> const& no = {}, double of_yes = 0.25, double of_no = 0.75,
                           double gamma = 2, double ignored = -100, bool ignores = true, bool summed = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"binary_focal">(pred, target, yes, no, of_yes, of_no, gamma, ignored, ignores, summed)};
  };
  auto const gradient = [=](Backward const& b) {
    auto const factors = [&](size_t i) { return b.saved[i].defined() ? std::optional(b.saved[i]) : std::nullopt; };
    auto const by = [&](bool target) {
      return b.wanted(target) ? binary_focal_backward(b.grads[0], b.saved[0], b.saved[1], factors(2), factors(3),
                                                      of_yes, of_no, gamma, ignored, ignores, summed, target)
                              : Tensor();
    };
    return variable_list{by(false), by(true)};
  };
  return differentiable({pred, target}, compute, {pred, target, yes.value_or(Tensor()), no.value_or(Tensor())},
                        gradient)[0];
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

inline Tensor smoothness_backward(Tensor const& grad, Tensor const& depth, Tensor const& image, double along_y,
                                  double along_x, bool of_image) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"smoothness_backward">(grad, depth, image, along_y, along_x, of_image)};
  };
  return differentiable({grad, depth, image}, compute, {}, no_second_derivative("smoothness"))[0];
}

// (B): for every sample what neighbours in depth (B, 1, H, W) differ by, less at the image's edges, summed with a
// weight along y and one along x.
inline Tensor smoothness(Tensor const& depth, Tensor const& image, double along_y = 1, double along_x = 1) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"smoothness">(depth, image, along_y, along_x)}; };
  auto const gradient = [=](Backward const& b) {
    auto const by = [&](bool image) {
      return b.wanted(image) ? smoothness_backward(b.grads[0], b.saved[0], b.saved[1], along_y, along_x, image)
                             : Tensor();
    };
    return variable_list{by(false), by(true)};
  };
  return differentiable({depth, image}, compute, {depth, image}, gradient)[0];
}

inline Tensor mutual_information_backward(Tensor const& grad, Tensor const& slopes, Tensor const& ranges,
                                          Tensor const& input, Tensor const& other,
                                          std::optional<Tensor> const& input_mask,
                                          std::optional<Tensor> const& other_mask, std::string const& kernel,
                                          int64_t bins, double radius, bool normalized, bool by_other) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"mutual_information_backward">(grad, slopes, ranges, input, other, input_mask, other_mask,
                                                             kernel, bins, radius, normalized, by_other)};
  };
  return differentiable({grad, input, other}, compute, {}, no_second_derivative("mutual_information"))[0];
}

// (B): the negative mutual information of signals (B, N), float32 or float64, of the samples in both masks (B or 1, N).
// kernel: "xu", "rectangular" or "truncated_gaussian". Then, without gradients, its slopes by the joint histogram
// (B, bins, bins) and the ranges of both signals (B, 4).
inline std::tuple<Tensor, Tensor, Tensor> mutual_information(Tensor const& input, Tensor const& other,
                                                             std::optional<Tensor> const& input_mask = {},
                                                             std::optional<Tensor> const& other_mask = {},
                                                             std::string const& kernel = "xu", int64_t bins = 64,
                                                             double radius = 1, bool normalized = false) {
  using namespace detail;
  auto const compute = [&] {
    auto [loss, slopes, ranges] = call<"mutual_information", std::tuple<Tensor, Tensor, Tensor>>(
        input, other, input_mask, other_mask, kernel, bins, radius, normalized);
    return variable_list{loss, slopes, ranges};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const x = b.saved[0], y = b.saved[1];
    auto const [loss, slopes, ranges] =
        mutual_information(x.detach(), y.detach(), input_mask, other_mask, kernel, bins, radius, normalized);
    auto const by = [&, slopes = slopes, ranges = ranges](bool other) {
      return b.wanted(other) ? mutual_information_backward(b.grads[0], slopes, ranges, x, y, input_mask, other_mask,
                                                           kernel, bins, radius, normalized, other)
                             : Tensor();
    };
    return variable_list{by(false), by(true)};
  };
  variable_list const found = differentiable({input, other}, compute, {input, other}, gradient);
  return {found[0], found[1].detach(), found[2].detach()};
}

}  // namespace kvision
