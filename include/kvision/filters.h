// Filters of images (B, C, H, W) and volumes (B, C, D, H, W), as python/kvision/filters has them.
#pragma once

#include <numeric>

#include "kvision/ops/filters.h"
#include "kvision/types.h"

namespace kvision {

// --- edges

inline Tensor sobel(Tensor const& input, bool normalized = true, double eps = 1e-6) {
  return ops::sobel(detail::floats_or_bytes(detail::images("sobel", "input", input)), normalized, eps);
}

// (B, C, 2, H, W): d/dx, d/dy; or for order 2 (B, C, 3, H, W): the second ones.
inline Tensor spatial_gradient(Tensor const& input, DerivativeMode mode = DerivativeMode::sobel, int64_t order = 1,
                               bool normalized = true) {
  auto const x = detail::floats_or_bytes(detail::images("spatial_gradient", "input", input));
  return ops::spatial_gradient(x, int64_t(mode), order, normalized);
}
// (B, C, 3, D, H, W), or for order 2 (B, C, 6, D, H, W), by central differences.
inline Tensor spatial_gradient3d(Tensor const& input, int64_t order = 1) {
  return ops::spatial_gradient3d(detail::floats(detail::volumes("spatial_gradient3d", "input", input)), order);
}

inline Tensor laplacian(Tensor const& input, Size2d kernel_size, BorderType border_type = BorderType::reflect,
                        bool normalized = true) {
  return ops::laplacian(detail::images("laplacian", "input", input), kernel_size->at(0), kernel_size->at(1), normalized,
                        int64_t(border_type));
}

// --- blurs

inline Tensor box_blur(Tensor const& input, Size2d kernel_size, BorderType border_type = BorderType::reflect) {
  return ops::box_blur(detail::images("box_blur", "input", input), kernel_size->at(0), kernel_size->at(1),
                       int64_t(border_type));
}

inline Tensor median_blur(Tensor const& input, Size2d kernel_size, BorderType border_type = BorderType::reflect) {
  return ops::median_blur(detail::images("median_blur", "input", input), kernel_size->at(0), kernel_size->at(1),
                          int64_t(border_type));
}

namespace detail {

inline Tensor bilateral(char const* op, Tensor const& input, std::optional<Tensor> const& guidance, Size2d kernel_size,
                        Parameter const& sigma_color, Sigma const& sigma_space, BorderType border_type,
                        Distance distance) {
  images(op, "input", input);
  if (guidance) images(op, "guidance", *guidance);
  // The kernels that read the totals are those of float32 images on a GPU.
  bool const keeps_totals = input.is_cuda() && input.scalar_type() == at::kFloat && !guidance &&
                            input.requires_grad() && at::GradMode::is_enabled();
  return std::get<0>(ops::bilateral_blur(input, computed(guidance, input), computed(sigma_color.tensor, input),
                                         computed(sigma_space.tensor, input), kernel_size->at(0), kernel_size->at(1),
                                         sigma_color.number, sigma_space.y, sigma_space.x, int64_t(border_type),
                                         int64_t(distance), keeps_totals));
}

}  // namespace detail

// sigma_color: a number, or a tensor (B or 1).
inline Tensor bilateral_blur(Tensor const& input, Size2d kernel_size, Parameter const& sigma_color,
                             Sigma const& sigma_space, BorderType border_type = BorderType::reflect,
                             Distance color_distance_type = Distance::l1) {
  return detail::bilateral("bilateral_blur", input, {}, kernel_size, sigma_color, sigma_space, border_type,
                           color_distance_type);
}
// The colors of the guidance are compared instead of those of the input.
inline Tensor joint_bilateral_blur(Tensor const& input, Tensor const& guidance, Size2d kernel_size,
                                   Parameter const& sigma_color, Sigma const& sigma_space,
                                   BorderType border_type = BorderType::reflect,
                                   Distance color_distance_type = Distance::l1) {
  return detail::bilateral("joint_bilateral_blur", input, guidance, kernel_size, sigma_color, sigma_space, border_type,
                           color_distance_type);
}

namespace detail {

// A blur by Gaussians that have a gradient to their sigmas (B or 1, 2).
inline Tensor gaussian_of_variable(Tensor const& input, Tensor const& sigma, Size2d kernel_size, int64_t border) {
  auto const weights = [&](int64_t axis) {
    Tensor const width = sigma.to(at::kDouble).narrow(1, axis, 1);
    int64_t const size = kernel_size->at(axis);
    Tensor const distance = at::arange(size, width.options()) - size / 2;
    return computed(at::softmax(-distance.square() / (2 * width.square()), 1), input);
  };
  return ops::filter2d_separable(input, weights(1), weights(0), border, true);
}
inline bool is_variable(std::optional<Tensor> const& x) {
  return x && x->requires_grad() && at::GradMode::is_enabled();
}

}  // namespace detail

inline Tensor gaussian_blur2d(Tensor const& input, Size2d kernel_size, Sigma const& sigma,
                              BorderType border_type = BorderType::reflect) {
  detail::images("gaussian_blur2d", "input", input);
  int64_t const border = int64_t(border_type);
  if (detail::is_variable(sigma.tensor)) return detail::gaussian_of_variable(input, *sigma.tensor, kernel_size, border);
  return ops::gaussian_blur2d(input, detail::computed(sigma.tensor, input), kernel_size->at(0), kernel_size->at(1),
                              sigma.y, sigma.x, border);
}

inline Tensor unsharp_mask(Tensor const& input, Size2d kernel_size, Sigma const& sigma,
                           BorderType border_type = BorderType::reflect) {
  detail::images("unsharp_mask", "input", input);
  int64_t const border = int64_t(border_type);
  if (detail::is_variable(sigma.tensor))
    return 2 * input - detail::gaussian_of_variable(input, *sigma.tensor, kernel_size, border);
  return ops::unsharp_mask(input, detail::computed(sigma.tensor, input), kernel_size->at(0), kernel_size->at(1),
                           sigma.y, sigma.x, border);
}

struct CannyOptions {
  TORCH_ARG(double, low_threshold) = 0.1;
  TORCH_ARG(double, high_threshold) = 0.2;
  TORCH_ARG(Size2d, kernel_size) = 5;
  TORCH_ARG(Sigma, sigma) = 1;
  TORCH_ARG(bool, hysteresis) = true;
  TORCH_ARG(double, eps) = 1e-6;
};

// Magnitudes and edges (B, 1, H, W) of gray or RGB images; with hysteresis edges are 0 and 1, without it weak ones 0.5.
inline std::tuple<Tensor, Tensor> canny(Tensor const& input, CannyOptions const& options = {}) {
  Tensor x = detail::floats(detail::images("canny", "input", input));
  TORCH_CHECK_VALUE(x.size(1) == 1 || x.size(1) == 3, "canny: expected input of shape (B, 1 or 3, H, W), got ",
                    x.sizes());
  if (x.size(1) == 3) x = kLuma[0] * x.narrow(1, 0, 1) + kLuma[1] * x.narrow(1, 1, 1) + kLuma[2] * x.narrow(1, 2, 1);
  x = gaussian_blur2d(x, options.kernel_size(), options.sigma());
  auto const [magnitude, edges] =
      ops::canny_suppress(x, options.low_threshold(), options.high_threshold(), options.eps());
  return {magnitude, options.hysteresis() ? ops::canny_hysteresis(edges) : edges};
}

// --- any kernel

struct FilterOptions {
  TORCH_ARG(BorderType, border_type) = BorderType::reflect;
  TORCH_ARG(bool, normalized) = false;          // whether the kernel is divided by the sum of its absolute values
  TORCH_ARG(Padding, padding) = Padding::same;  // valid: only where the kernel fits inside
};

namespace detail {

inline Tensor kernel(Tensor const& x, Tensor const& input, FilterOptions const& options) {
  Tensor const k = computed(x, input);
  std::vector<int64_t> axes(k.dim() - 1);
  std::iota(axes.begin(), axes.end(), 1);
  return options.normalized() ? k / k.abs().sum(axes, true) : k;
}

}  // namespace detail

// Correlation with kernels (B or 1, kH, kW); flip them for a convolution.
inline Tensor filter2d(Tensor const& input, Tensor const& kernel, FilterOptions const& options = {}) {
  detail::images("filter2d", "input", input);
  detail::shaped("filter2d", "kernel", kernel, 3, "(B or 1, kH, kW)");
  return ops::filter2d(input, detail::kernel(kernel, input, options), int64_t(options.border_type()),
                       options.padding() == Padding::same);
}
// Of kernels (B or 1, kD, kH, kW).
inline Tensor filter3d(Tensor const& input, Tensor const& kernel,
                       FilterOptions const& options = FilterOptions().border_type(BorderType::replicate)) {
  detail::volumes("filter3d", "input", input);
  detail::shaped("filter3d", "kernel", kernel, 4, "(B or 1, kD, kH, kW)");
  return ops::filter3d(input, detail::kernel(kernel, input, options), int64_t(options.border_type()),
                       options.padding() == Padding::same);
}
// Of kernels (B or 1, kW) along x and (B or 1, kH) along y.
inline Tensor filter2d_separable(Tensor const& input, Tensor const& kernel_x, Tensor const& kernel_y,
                                 FilterOptions const& options = {}) {
  detail::images("filter2d_separable", "input", input);
  detail::shaped("filter2d_separable", "kernel_x", kernel_x, 2, "(B or 1, kW)");
  detail::shaped("filter2d_separable", "kernel_y", kernel_y, 2, "(B or 1, kH)");
  return ops::filter2d_separable(input, detail::kernel(kernel_x, input, options),
                                 detail::kernel(kernel_y, input, options), int64_t(options.border_type()),
                                 options.padding() == Padding::same);
}

}  // namespace kvision
