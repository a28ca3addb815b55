// Metrics. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/metrics
// explains, and gradients. Images are (B, C, H, W). A second derivative is an error.
#pragma once

#include <ATen/TensorOperators.h>

#include <string>
#include <tuple>

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

}  // namespace kvision
