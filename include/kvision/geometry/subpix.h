// Maxima and their positions between pixels, as python/kvision/geometry/subpix has them.
#pragma once

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

namespace detail {

inline Tensor to_bool(Tensor const& flags) { return flags.to(at::kBool); }

}  // namespace detail

// What is above all others of its window, 0 elsewhere; with mask_only where that is.
inline Tensor nms2d(Tensor const& input, Size2d kernel_size, bool mask_only = false) {
  Tensor const x = detail::floats(detail::images("nms2d", "input", input));
  std::vector<int64_t> const window{1, kernel_size->at(0), kernel_size->at(1)};
  if (mask_only) return detail::to_bool(ops::nms_mask(x, window, false));
  return std::get<0>(ops::nms(x, window, false, false));
}
inline Tensor nms3d(Tensor const& input, Size3d kernel_size, bool mask_only = false) {
  Tensor const x = detail::floats(detail::volumes("nms3d", "input", input)).flatten(0, 1);
  auto const window = detail::list(kernel_size);
  if (mask_only) return detail::to_bool(ops::nms_mask(x, window, true)).view(input.sizes());
  return std::get<0>(ops::nms(x, window, true, false)).view(input.sizes());
}
// Where there are maxima and minima among 3 x 3 x 3 voxels.
inline std::tuple<Tensor, Tensor> nms3d_minmax(Tensor const& input) {
  Tensor const x = detail::floats(detail::volumes("nms3d_minmax", "input", input)).flatten(0, 1);
  auto const [maxima, minima] = ops::nms_minmax_masks(x, {3, 3, 3}, true);
  return {detail::to_bool(maxima).view(input.sizes()), detail::to_bool(minima).view(input.sizes())};
}

namespace detail {

inline Tensor spatial_expectation(char const* op, Tensor const& input, bool softmax, double scale, bool normalized) {
  Tensor const x = floats(images(op, "input", input));
  return std::get<0>(ops::spatial_expectation(x, softmax, scale, normalized)).to(x.scalar_type());
}

}  // namespace detail

// The mean positions (B, C, 2) of pixels, x before y, weighted by values, or by the softmax of values / temperature.
inline Tensor spatial_expectation2d(Tensor const& input, bool normalized_coordinates = true) {
  return detail::spatial_expectation("spatial_expectation2d", input, false, 1, normalized_coordinates);
}
inline Tensor spatial_soft_argmax2d(Tensor const& input, double temperature = 1, bool normalized_coordinates = true) {
  return detail::spatial_expectation("spatial_soft_argmax2d", input, true, 1 / temperature, normalized_coordinates);
}

// Gaussians (N, *size) of means and standard deviations (N or 1, 2), x before y, each of which adds up to 1.
inline Tensor render_gaussian2d(Tensor const& mean, Tensor const& std, Size2d size,
                                bool normalized_coordinates = true) {
  return ops::render_gaussian2d(detail::shaped("render_gaussian2d", "mean", mean, 2, "(N, 2)"), std, size->at(0),
                                size->at(1), normalized_coordinates);
}

template <int axes>
struct ConvSoftArgmaxOptions {
  TORCH_ARG(torch::ExpandingArray<axes>, kernel_size) = 3;
  TORCH_ARG(torch::ExpandingArray<axes>, stride) = 1;
  TORCH_ARG(torch::ExpandingArray<axes>, padding) = 1;
  TORCH_ARG(double, temperature) = 1;
  TORCH_ARG(bool, normalized_coordinates) = axes == 2;
};
// Of every window its mean position (B, C, 2, h, w) under the softmax of its values, and their mean (B, C, h, w).
inline std::tuple<Tensor, Tensor> conv_soft_argmax2d(Tensor const& input,
                                                     ConvSoftArgmaxOptions<2> const& options = {}) {
  Tensor const x = detail::floats(detail::images("conv_soft_argmax2d", "input", input)).unsqueeze(2);
  auto const [k, s, p] = std::tuple(*options.kernel_size(), *options.stride(), *options.padding());
  auto const [positions, values] =
      ops::soft_argmax(x, {1, k[0], k[1]}, {1, s[0], s[1]}, {0, p[0], p[1]}, options.temperature(),
                       options.normalized_coordinates(), false, true);
  return {positions.squeeze(3), values.squeeze(2)};
}
// Positions (B, C, 3, d, h, w) are (z, x, y).
inline std::tuple<Tensor, Tensor> conv_soft_argmax3d(Tensor const& input,
                                                     ConvSoftArgmaxOptions<3> const& options = {}) {
  Tensor const x = detail::floats(detail::volumes("conv_soft_argmax3d", "input", input));
  return ops::soft_argmax(x, detail::list(options.kernel_size()), detail::list(options.stride()),
                          detail::list(options.padding()), options.temperature(), options.normalized_coordinates(),
                          true, true);
}

struct QuadInterpOptions {
  TORCH_ARG(int64_t, n_iters) = 5;
  TORCH_ARG(double, max_subpixel_shift) = 0.6;
  TORCH_ARG(std::optional<Tensor>, precomputed_nms_mask);
  TORCH_ARG(int64_t, dilation_radius) = 1;
  TORCH_ARG(bool, allow_scale_steps) = true;
};
// Positions (z, x, y) of the maxima of volumes between voxels, (B, C, 3, D, H, W), and the values there.
inline std::tuple<Tensor, Tensor> conv_quad_interp3d(Tensor const& input, QuadInterpOptions const& options = {}) {
  auto const& mask = options.precomputed_nms_mask();
  return ops::conv_quad_interp3d(detail::floats(detail::volumes("conv_quad_interp3d", "input", input)),
                                 mask ? std::optional(mask->to(at::kByte)) : std::nullopt, options.n_iters(),
                                 options.max_subpixel_shift(), options.dilation_radius(), options.allow_scale_steps());
}

}  // namespace kvision
