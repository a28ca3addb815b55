// Statistics of whole images. Each function has the arguments of the operator torch.ops.kvision.<name>, which
// python/kvision/enhance explains, and gradients. Images are (B, C, H, W). A second derivative is an error.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include <optional>
#include <string>
#include <tuple>

#include "kvision/operator.h"

namespace kvision {

// The image and, for every plane, whether it was changed: (B, C). Levels have no gradient; what comes back as it is,
// a plane of one level or NaN, has its own.
// Of equalize, and without `changed` of equalize_clahe: levels have no gradient, what comes back as it is has its own.
inline Tensor equalize_backward(Tensor const& grad, Tensor const& output, std::optional<Tensor> const& changed) {
  auto const transpose = [=](Tensor const& g) { return equalize_backward(g, output, changed); };
  return detail::linear<"equalize_backward">(grad, transpose, output, changed);
}

inline std::tuple<Tensor, Tensor> equalize(Tensor const& input, bool opencv = false) {
  using namespace detail;
  auto const [output, changed] = [&] {
    at::NoGradGuard no_grad;
    return call<"equalize", std::tuple<Tensor, Tensor>>(input.detach(), opencv);
  }();
  auto const compute = [&] { return variable_list{output}; };
  auto const gradient = [](Backward const& b) {
    return variable_list{equalize_backward(b.grads[0], b.saved[0], b.saved[1])};
  };
  return {differentiable({input}, compute, {output, changed}, gradient)[0], changed};
}

inline Tensor equalize_clahe(Tensor const& input, double clip_limit = 40, int64_t rows = 8, int64_t columns = 8,
                             bool opencv = false) {
  using namespace detail;
  Tensor const output = [&] {
    at::NoGradGuard no_grad;
    return call<"equalize_clahe">(input.detach(), clip_limit, rows, columns, opencv);
  }();
  auto const compute = [&] { return variable_list{output}; };
  auto const gradient = [](Backward const& b) {
    return variable_list{equalize_backward(b.grads[0], b.saved[0], std::nullopt)};
  };
  return differentiable({input}, compute, {output}, gradient)[0];
}

inline Tensor normalize_min_max_backward(Tensor const& grad, Tensor const& input, Tensor const& range, double low,
                                         double high, double eps) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"normalize_min_max_backward">(grad, input, range, low, high, eps)};
  };
  return differentiable({grad, input}, compute, {}, no_second_derivative("normalize_min_max"))[0];
}

// The image, and the smallest and largest value of every plane: (B, C, 2), without a gradient.
inline std::tuple<Tensor, Tensor> normalize_min_max(Tensor const& input, double low = 0, double high = 1,
                                                    double eps = 1e-6) {
  using namespace detail;
  auto const compute = [&] {
    auto [output, range] = call<"normalize_min_max", std::tuple<Tensor, Tensor>>(input, low, high, eps);
    return variable_list{output, range};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const range = std::get<1>(normalize_min_max(b.saved[0].detach(), low, high, eps));
    return variable_list{normalize_min_max_backward(b.grads[0], b.saved[0], range, low, high, eps)};
  };
  variable_list const found = differentiable({input}, compute, {input}, gradient);
  return {found[0], found[1].detach()};
}

inline Tensor gaussian_counts_backward(Tensor const& grad, Tensor const& x, Tensor const& centers,
                                       Tensor const& bandwidth) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"gaussian_counts_backward">(grad, x, centers, bandwidth)}; };
  return differentiable({grad, x, centers, bandwidth}, compute, {}, no_second_derivative("gaussian_counts"))[0];
}

// Of values (N, P), centers (N or 1, K) and bandwidths (N or 1), the sums of Gaussians (N, K). The gradient is that of
// the values.
inline Tensor gaussian_counts(Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"gaussian_counts">(x, centers, bandwidth)}; };
  auto const gradient = [](Backward const& b) {
    TORCH_CHECK_NOT_IMPLEMENTED(!b.wanted(1) && !b.wanted(2),
                                "gaussian_counts: C++ has no gradient of centers or "
                                "bandwidth; Python's kvision has");
    return variable_list{gaussian_counts_backward(b.grads[0], b.saved[0], b.saved[1], b.saved[2]), {}, {}};
  };
  return differentiable({x, centers, bandwidth}, compute, {x, centers, bandwidth}, gradient)[0];
}

inline Tensor grid_counts_backward(Tensor const& grad, Tensor const& x, double low, double width, int64_t bins,
                                   std::string const& kernel) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"grid_counts_backward">(grad, x, low, width, bins, kernel)}; };
  return differentiable({grad, x}, compute, {}, no_second_derivative("grid_counts"))[0];
}

// Of values (N, P), the counts in bins of a width, the first of which begins at `low`: (N, bins). kernel: "triangular",
// "epanechnikov" or "uniform".
inline Tensor grid_counts(Tensor const& x, double low, double width, int64_t bins,
                          std::string const& kernel = "triangular") {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"grid_counts">(x, low, width, bins, kernel)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{grid_counts_backward(b.grads[0], b.saved[0], low, width, bins, kernel)};
  };
  return differentiable({x}, compute, {x}, gradient)[0];
}

// alpha input + beta other + gamma, by weights (B, C, 1) with axes of size 1 where they are shared, in the type that is
// computed in; or by the numbers a, b and c in their places.
inline Tensor mix(Tensor const& input, Tensor const& other, std::optional<Tensor> const& alpha,
                  std::optional<Tensor> const& beta, std::optional<Tensor> const& gamma, double a, double b, double c) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"mix">(input, other, alpha, beta, gamma, a, b, c)}; };
  auto const gradient = [=](Backward const& back) {
    Tensor const &g = back.grads[0], &x = back.saved[0], &y = back.saved[1];
    auto const scaled = [&](Tensor const& weights, double number) {
      return weights.defined() ? (g * weights.unsqueeze(3)).to(g.scalar_type()) : g * number;
    };
    auto const summed = [&](size_t i, Tensor const& pixels) {
      return back.wanted(i) ? at::sum_to(pixels, back.saved[i].unsqueeze(3).sizes()).squeeze(3) : Tensor();
    };
    return variable_list{scaled(back.saved[2], a), scaled(back.saved[3], b), summed(2, g * x), summed(3, g * y),
                         summed(4, g)};
  };
  variable_list const tensors{input, other, alpha.value_or(Tensor()), beta.value_or(Tensor()),
                              gamma.value_or(Tensor())};
  return differentiable(tensors, compute, tensors, gradient)[0];
}

// The gradients of the image and of every channel's factor, (B, C, 1); without elements where they are not wanted.
inline std::tuple<Tensor, Tensor> sharpness_backward(Tensor const& grad, Tensor const& input,
                                                     std::optional<Tensor> const& factor, double number, bool of_image,
                                                     bool of_factor) {
  using namespace detail;
  auto const compute = [&] {
    auto const [of_x, of_planes] =
        call<"sharpness_backward", std::tuple<Tensor, Tensor>>(grad, input, factor, number, of_image, of_factor);
    return variable_list{of_x, of_planes};
  };
  auto const found =
      differentiable({grad, input, factor.value_or(Tensor())}, compute, {}, no_second_derivative("sharpness"));
  return {found[0], found[1]};
}

// By a factor (B, C, 1) with axes of size 1 where it is shared, in the type that is computed in; or by the number.
inline Tensor sharpness(Tensor const& input, std::optional<Tensor> const& factor, double number) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"sharpness">(input, factor, number)}; };
  auto const gradient = [=](Backward const& b) {
    Tensor const& f = b.saved[1];
    auto const given = f.defined() ? std::optional(f) : std::nullopt;
    auto const [of_x, of_planes] = sharpness_backward(b.grads[0], b.saved[0], given, number, b.wanted(0), b.wanted(1));
    return variable_list{b.wanted(0) ? of_x : Tensor(), b.wanted(1) ? of_planes.sum_to_size(f.sizes()) : Tensor()};
  };
  variable_list const tensors{input, factor.value_or(Tensor())};
  return differentiable(tensors, compute, tensors, gradient)[0];
}

// The gradients of the image, and of every image's quality (B, 1) and tables (B, 8, 8); without elements where they are
// not wanted.
inline std::tuple<Tensor, Tensor, Tensor, Tensor> jpeg_backward(Tensor const& grad, Tensor const& input,
                                                                std::optional<Tensor> const& quality,
                                                                std::optional<Tensor> const& table_y,
                                                                std::optional<Tensor> const& table_c, double number,
                                                                bool of_image, bool of_steps) {
  using namespace detail;
  auto const compute = [&] {
    auto const [of_x, of_quality, of_y, of_c] = call<"jpeg_backward", std::tuple<Tensor, Tensor, Tensor, Tensor>>(
        grad, input, quality, table_y, table_c, number, of_image, of_steps);
    return variable_list{of_x, of_quality, of_y, of_c};
  };
  variable_list const tensors{grad, input, quality.value_or(Tensor()), table_y.value_or(Tensor()),
                              table_c.value_or(Tensor())};
  auto const found = differentiable(tensors, compute, {}, no_second_derivative("jpeg"));
  return {found[0], found[1], found[2], found[3]};
}

// By a quality (B,), or the number, and tables (B, 8, 8), or those of the standard; B may be 1.
inline Tensor jpeg(Tensor const& input, std::optional<Tensor> const& quality, std::optional<Tensor> const& table_y,
                   std::optional<Tensor> const& table_c, double number) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"jpeg">(input, quality, table_y, table_c, number)}; };
  auto const gradient = [=](Backward const& b) {
    auto const given = [&](size_t i) { return b.saved[i].defined() ? std::optional(b.saved[i]) : std::nullopt; };
    bool const of_steps = b.wanted(1) || b.wanted(2) || b.wanted(3);
    auto const [of_x, of_quality, of_y, of_c] =
        jpeg_backward(b.grads[0], b.saved[0], given(1), given(2), given(3), number, b.wanted(0), of_steps);
    auto const summed = [&](size_t i, Tensor const& t) {
      return b.wanted(i) ? t.sum_to_size(b.saved[i].sizes()) : Tensor();
    };
    return variable_list{b.wanted(0) ? of_x : Tensor(), summed(1, of_quality.flatten()), summed(2, of_y),
                         summed(3, of_c)};
  };
  variable_list const tensors{input, quality.value_or(Tensor()), table_y.value_or(Tensor()),
                              table_c.value_or(Tensor())};
  return differentiable(tensors, compute, tensors, gradient)[0];
}

}  // namespace kvision
