// Metrics. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/metrics
// explains, and gradients. Images are (B, C, H, W). A second derivative is an error.
#pragma once

#include <ATen/TensorOperators.h>

#include <string>
#include <tuple>
#include <vector>

#include "kvision/operator.h"

namespace kvision {

inline Tensor ssim_backward(Tensor const& grad, Tensor const& input, Tensor const& other, int64_t size, double sigma,
                            double c1, double c2, double eps, std::string const& border, bool luminance) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"ssim_backward">(grad, input, other, size, sigma, c1, c2, eps, border, luminance)};
  };
  return differentiable({grad, input, other}, compute, {}, no_second_derivative("ssim"))[0];
}

inline std::tuple<Tensor, Tensor> ssim_backward_both(Tensor const& grad, Tensor const& input, Tensor const& other,
                                                     int64_t size, double sigma, double c1, double c2, double eps,
                                                     std::string const& border, bool luminance) {
  using namespace detail;
  auto const compute = [&] {
    auto [of_input, of_other] = call<"ssim_backward_both", std::tuple<Tensor, Tensor>>(grad, input, other, size, sigma,
                                                                                       c1, c2, eps, border, luminance);
    return variable_list{of_input, of_other};
  };
  variable_list const found = differentiable({grad, input, other}, compute, {}, no_second_derivative("ssim"));
  return {found[0], found[1]};
}

// The structural similarity of two images of one shape, in Gaussian windows. border: "reflect", "constant" for zeros,
// or "valid" for windows inside of the images only.
inline Tensor ssim(Tensor const& input, Tensor const& other, int64_t size = 11, double sigma = 1.5, double c1 = 1e-4,
                   double c2 = 9e-4, double eps = 1e-12, std::string const& border = "reflect", bool luminance = true) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"ssim">(input, other, size, sigma, c1, c2, eps, border, luminance)};
  };
  auto const gradient = [=](Backward const& b) {
    auto const [of_input, of_other] =
        ssim_backward_both(b.grads[0], b.saved[0], b.saved[1], size, sigma, c1, c2, eps, border, luminance);
    return variable_list{of_input, of_other};
  };
  return differentiable({input, other}, compute, {input, other}, gradient)[0];
}

inline Tensor ssim_loss_backward(Tensor const& grad, Tensor const& input, Tensor const& other, int64_t size,
                                 double sigma, double c1, double c2, double eps, std::string const& border,
                                 double structure, double absolute) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"ssim_loss_backward">(grad, input, other, size, sigma, c1, c2, eps, border, structure, absolute)};
  };
  return differentiable({grad, input, other}, compute, {}, no_second_derivative("ssim_loss"))[0];
}

inline std::tuple<Tensor, Tensor> ssim_loss_backward_both(Tensor const& grad, Tensor const& input, Tensor const& other,
                                                          int64_t size, double sigma, double c1, double c2, double eps,
                                                          std::string const& border, double structure,
                                                          double absolute) {
  using namespace detail;
  auto const compute = [&] {
    auto [of_input, of_other] = call<"ssim_loss_backward_both", std::tuple<Tensor, Tensor>>(
        grad, input, other, size, sigma, c1, c2, eps, border, structure, absolute);
    return variable_list{of_input, of_other};
  };
  variable_list const found = differentiable({grad, input, other}, compute, {}, no_second_derivative("ssim_loss"));
  return {found[0], found[1]};
}

// (B): for every sample the sums of 1 - similarity and of abs(input - other), each times its weight.
inline Tensor ssim_loss(Tensor const& input, Tensor const& other, int64_t size = 11, double sigma = 1.5,
                        double c1 = 1e-4, double c2 = 9e-4, double eps = 1e-12, std::string const& border = "reflect",
                        double structure = 1, double absolute = 0) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"ssim_loss">(input, other, size, sigma, c1, c2, eps, border, structure, absolute)};
  };
  auto const gradient = [=](Backward const& b) {
    if (!b.wanted(1))
      return variable_list{
          ssim_loss_backward(b.grads[0], b.saved[0], b.saved[1], size, sigma, c1, c2, eps, border, structure, absolute),
          {}};
    auto const [of_input, of_other] = ssim_loss_backward_both(b.grads[0], b.saved[0], b.saved[1], size, sigma, c1, c2,
                                                              eps, border, structure, absolute);
    return variable_list{of_input, of_other};
  };
  return differentiable({input, other}, compute, {input, other}, gradient)[0];
}

inline Tensor ms_ssim_backward(Tensor const& grad, Tensor const& input, Tensor const& other,
                               std::vector<double> const& sigmas, int64_t size, double c1, double c2, double structure,
                               double absolute) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"ms_ssim_backward">(grad, input, other, sigmas, size, c1, c2, structure, absolute)};
  };
  return differentiable({grad, input, other}, compute, {}, no_second_derivative("ms_ssim"))[0];
}

inline std::tuple<Tensor, Tensor> ms_ssim_backward_both(Tensor const& grad, Tensor const& input, Tensor const& other,
                                                        std::vector<double> const& sigmas, int64_t size, double c1,
                                                        double c2, double structure, double absolute) {
  using namespace detail;
  auto const compute = [&] {
    auto [of_input, of_other] = call<"ms_ssim_backward_both", std::tuple<Tensor, Tensor>>(
        grad, input, other, sigmas, size, c1, c2, structure, absolute);
    return variable_list{of_input, of_other};
  };
  variable_list const found = differentiable({grad, input, other}, compute, {}, no_second_derivative("ms_ssim"));
  return {found[0], found[1]};
}

// (B, H, W): the mean over the channels of 1 - the product of the similarities in Gaussian windows of these sigmas,
// only the last of which has luminance, and of abs(input - other) in that one's window, each times its weight.
inline Tensor ms_ssim(Tensor const& input, Tensor const& other, std::vector<double> const& sigmas = {0.5, 1, 2, 4, 8},
                      int64_t size = 33, double c1 = 1e-4, double c2 = 9e-4, double structure = 5,
                      double absolute = 195) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"ms_ssim">(input, other, sigmas, size, c1, c2, structure, absolute)};
  };
  auto const gradient = [=](Backward const& b) {
    if (!b.wanted(1))
      return variable_list{
          ms_ssim_backward(b.grads[0], b.saved[0], b.saved[1], sigmas, size, c1, c2, structure, absolute), {}};
    auto const [of_input, of_other] =
        ms_ssim_backward_both(b.grads[0], b.saved[0], b.saved[1], sigmas, size, c1, c2, structure, absolute);
    return variable_list{of_input, of_other};
  };
  return differentiable({input, other}, compute, {input, other}, gradient)[0];
}

inline Tensor pointwise_loss_backward(Tensor const& grad, Tensor const& input, Tensor const& other,
                                      std::string const& kind, bool by_other) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"pointwise_loss_backward">(grad, input, other, kind, by_other)};
  };
  return differentiable({grad, input, other}, compute, {}, no_second_derivative("pointwise_loss"))[0];
}

// The loss of every element of input and other (rows, size). kind: "charbonnier", "welsch", "cauchy", "geman_mcclure",
// "square", or "kl" and "js" of predicted and true probabilities.
inline Tensor pointwise_loss(Tensor const& input, Tensor const& other, std::string const& kind) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"pointwise_loss">(input, other, kind)}; };
  auto const gradient = [=](Backward const& b) {
    auto const by = [&](bool other) {
      return b.wanted(other) ? pointwise_loss_backward(b.grads[0], b.saved[0], b.saved[1], kind, other) : Tensor();
    };
    return variable_list{by(false), by(true)};
  };
  return differentiable({input, other}, compute, {input, other}, gradient)[0];
}

inline Tensor pointwise_sum_backward(Tensor const& grad, Tensor const& sums, Tensor const& input, Tensor const& other,
                                     std::string const& kind, double factor, double decibels, bool by_other) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"pointwise_sum_backward">(grad, sums, input, other, kind, factor, decibels, by_other)};
  };
  return differentiable({grad, sums, input, other}, compute, {}, no_second_derivative("pointwise_sum"))[0];
}

// (rows): factor times the sum of each row's losses, or where there are `decibels` that many times its logarithm to
// base 10, which has a gradient in Python only.
inline Tensor pointwise_sum(Tensor const& input, Tensor const& other, std::string const& kind, double factor = 1,
                            double decibels = 0) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"pointwise_sum">(input, other, kind, factor, decibels)}; };
  auto const gradient = [=](Backward const& b) {
    TORCH_CHECK_NOT_IMPLEMENTED(decibels == 0, "pointwise_sum: C++ has no gradient of decibels; Python's kvision has");
    auto const by = [&](bool other) {
      if (!b.wanted(other)) return Tensor();
      return pointwise_sum_backward(b.grads[0], b.grads[0], b.saved[0], b.saved[1], kind, factor, 0, other);
    };
    return variable_list{by(false), by(true)};
  };
  return differentiable({input, other}, compute, {input, other}, gradient)[0];
}

inline Tensor endpoint_error_backward(Tensor const& grad, Tensor const& input, Tensor const& target, bool planar,
                                      bool summed, double factor) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"endpoint_error_backward">(grad, input, target, planar, summed, factor)};
  };
  return differentiable({grad, input, target}, compute, {}, no_second_derivative("endpoint_error"))[0];
}

// The distances (rows, size) of vectors (rows, size, 2), or (rows, 2, size) if planar; or `factor` times their sums
// (rows).
inline Tensor endpoint_error(Tensor const& input, Tensor const& target, bool planar = false, bool summed = false,
                             double factor = 1) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"endpoint_error">(input, target, planar, summed, factor)}; };
  auto const gradient = [=](Backward const& b) {
    Tensor const found = endpoint_error_backward(b.grads[0], b.saved[0], b.saved[1], planar, summed, factor);
    return variable_list{found, -found};
  };
  return differentiable({input, target}, compute, {input, target}, gradient)[0];
}

// Of labels (B, N), int64 or uint8: wanted "counts" (B, classes, classes), a row for each class of the target; "rates",
// divided by the sum of their row plus eps; or "overlaps" (B, classes), intersection over union with eps on both sides.
inline Tensor confusion(Tensor const& pred, Tensor const& target, int64_t classes, std::string const& wanted = "counts",
                        double eps = 1e-6) {
  using namespace detail;
  return call<"confusion">(pred, target, classes, wanted, eps);
}

// (B, N, M): intersection over union of boxes (B, N, 4) and (B, M, 4), NaN of one without area. format: "xyxy",
// "xywh" or "cxcywh". It has a gradient in Python only.
inline Tensor box_overlaps(Tensor const& boxes, Tensor const& others, std::string const& format = "xyxy") {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"box_overlaps">(boxes, others, format)}; };
  auto const gradient = [](Backward const&) -> variable_list {
    TORCH_CHECK_NOT_IMPLEMENTED(false, "box_overlaps: C++ has no gradient; Python's kvision has");
  };
  return differentiable({boxes, others}, compute, {}, gradient)[0];
}

}  // namespace kvision
