// The filters. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/filters.h"

namespace kvision::ops {

namespace detail {

inline variable_list laplacian_gradients(Backward const& b);
inline variable_list laplacian_backward_gradients(Backward const& b);
inline variable_list sobel_gradients(Backward const& b);
inline variable_list spatial_gradient3d_gradients(Backward const& b);
inline variable_list spatial_gradient3d_backward_gradients(Backward const& b);
inline variable_list spatial_gradient_gradients(Backward const& b);
inline variable_list spatial_gradient_backward_gradients(Backward const& b);
inline variable_list filter2d_gradients(Backward const& b);
inline variable_list filter2d_backward_gradients(Backward const& b);
inline variable_list filter2d_kernel_backward_gradients(Backward const& b);
inline variable_list filter3d_gradients(Backward const& b);
inline variable_list filter3d_backward_gradients(Backward const& b);
inline variable_list filter3d_kernel_backward_gradients(Backward const& b);
inline variable_list box_blur_gradients(Backward const& b);
inline variable_list box_blur_backward_gradients(Backward const& b);
inline variable_list gaussian_blur2d_gradients(Backward const& b);
inline variable_list gaussian_blur2d_backward_gradients(Backward const& b);
inline variable_list median_blur_gradients(Backward const& b);
inline variable_list unsharp_mask_gradients(Backward const& b);
inline variable_list unsharp_mask_backward_gradients(Backward const& b);

}  // namespace detail

// --- filters/edges/canny_op.cpp

inline constexpr Operator<"canny_suppress", Two(Tensor input, double low, double high, double eps)> canny_suppress{
    detail::rules::canny_suppress};
inline constexpr Operator<"canny_hysteresis", Tensor(Tensor edges)> canny_hysteresis{non_differentiable};

// --- filters/edges/laplacian_op.cpp

inline constexpr Operator<"laplacian", Tensor(Tensor input, int64_t ky, int64_t kx, bool normalized, int64_t border)>
    laplacian{Rule{detail::laplacian_gradients, 0, false}};

// --- filters/edges/sobel_op.cpp

inline constexpr Operator<"sobel", Tensor(Tensor input, bool normalized, double eps)> sobel{
    Rule{detail::sobel_gradients}};

// --- filters/edges/spatial_gradient3d_op.cpp

inline constexpr Operator<"spatial_gradient3d", Tensor(Tensor input, int64_t order)> spatial_gradient3d{
    Rule{detail::spatial_gradient3d_gradients, 0, false}};

// --- filters/edges/spatial_gradient_op.cpp

inline constexpr Operator<"spatial_gradient", Tensor(Tensor input, int64_t mode, int64_t order, bool normalized)>
    spatial_gradient{Rule{detail::spatial_gradient_gradients, 0, false}};

// --- filters/filter2d_op.cpp

// The same as filter2d, clamped to [0, 1].
inline constexpr Operator<"filter2d_clamped", Tensor(Tensor input, Tensor kernel, int64_t border)> filter2d_clamped{
    detail::rules::filter2d_clamped};
inline constexpr Operator<"filter2d", Tensor(Tensor input, Tensor kernel, int64_t border, bool same)> filter2d{
    Rule{detail::filter2d_gradients}};
inline constexpr Operator<"filter3d", Tensor(Tensor input, Tensor kernel, int64_t border, bool same)> filter3d{
    Rule{detail::filter3d_gradients}};

// --- filters/separable_op.cpp

inline constexpr Operator<"filter2d_separable",
                          Tensor(Tensor input, Tensor kernel_x, Tensor kernel_y, int64_t border, bool same)>
    filter2d_separable{detail::rules::filter2d_separable};

// --- filters/smoothing/bilateral_op.cpp

inline constexpr Operator<"bilateral_blur",
                          Two(Tensor input, OptionalTensor guidance, OptionalTensor sigma_color,
                              OptionalTensor sigma_space, int64_t ky, int64_t kx, double color, double space_y,
                              double space_x, int64_t border, int64_t distance, bool keeps_totals)>
    bilateral_blur{detail::rules::bilateral_blur};
inline constexpr Operator<"bilateral_blur_sigma_sums",
                          Tensor(Tensor grad, Tensor input, OptionalTensor guidance, OptionalTensor sigma_color,
                                 OptionalTensor sigma_space, int64_t ky, int64_t kx, double color, double space_y,
                                 double space_x, int64_t border, int64_t distance)>
    bilateral_blur_sigma_sums{no_gradient};

// --- filters/smoothing/box_op.cpp

inline constexpr Operator<"box_blur", Tensor(Tensor input, int64_t ky, int64_t kx, int64_t border)> box_blur{
    Rule{detail::box_blur_gradients, 0, false}};

// --- filters/smoothing/gaussian_op.cpp

inline constexpr Operator<"gaussian_blur2d", Tensor(Tensor input, OptionalTensor sigma, int64_t ky, int64_t kx,
                                                    double sigma_y, double sigma_x, int64_t border)>
    gaussian_blur2d{Rule{detail::gaussian_blur2d_gradients, 0, false}};
inline constexpr Operator<"gaussian_levels", Tensor(Tensor input, Ints sizes, Floats sigmas, int64_t border)>
    gaussian_levels{detail::rules::gaussian_levels};

// --- filters/smoothing/median_op.cpp

inline constexpr Operator<"median_blur", Tensor(Tensor input, int64_t ky, int64_t kx, int64_t border)> median_blur{
    Rule{detail::median_blur_gradients, 1}};

// --- filters/smoothing/motion_op.cpp

inline constexpr Operator<"motion_kernel", Tensor(Tensor angle, Tensor direction, int64_t size, int64_t taps)>
    motion_kernel{no_gradient};

// --- filters/smoothing/unsharp_op.cpp

inline constexpr Operator<"unsharp_mask", Tensor(Tensor input, OptionalTensor sigma, int64_t ky, int64_t kx,
                                                 double sigma_y, double sigma_x, int64_t border)>
    unsharp_mask{Rule{detail::unsharp_mask_gradients, 0, false}};

// --- rules

namespace detail {

inline variable_list laplacian_gradients(Backward const& b) {
  return b.run("laplacian_backward", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               Rule{laplacian_backward_gradients, 0, false});
}

inline variable_list laplacian_backward_gradients(Backward const& b) {
  return b.run("laplacian", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               Rule{laplacian_gradients, 0, false});
}

inline variable_list sobel_gradients(Backward const& b) {
  return b.run("sobel_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list spatial_gradient3d_gradients(Backward const& b) {
  return b.run("spatial_gradient3d_backward", {b.grads[0], b.arguments[1]},
               Rule{spatial_gradient3d_backward_gradients, 0, false});
}

inline variable_list spatial_gradient3d_backward_gradients(Backward const& b) {
  return b.run("spatial_gradient3d", {b.grads[0], b.arguments[1]}, Rule{spatial_gradient3d_gradients, 0, false});
}

inline variable_list spatial_gradient_gradients(Backward const& b) {
  return b.run("spatial_gradient_backward", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]},
               Rule{spatial_gradient_backward_gradients, 0, false});
}

inline variable_list spatial_gradient_backward_gradients(Backward const& b) {
  return b.run("spatial_gradient", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]},
               Rule{spatial_gradient_gradients, 0, false});
}

inline variable_list filter2d_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] = b.run("filter2d_backward", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]},
                         Rule{filter2d_backward_gradients})[0];
  if (b.needs(1))
    gradients[1] =
        b.run("filter2d_kernel_backward", {b.arguments[1], b.grads[0], b.arguments[0], b.arguments[2], b.arguments[3]},
              Rule{filter2d_kernel_backward_gradients, 0, false})[0];
  return gradients;
}

inline variable_list filter2d_backward_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] =
        b.run("filter2d", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]}, Rule{filter2d_gradients})[0];
  if (b.needs(1))
    gradients[1] =
        b.run("filter2d_kernel_backward", {b.arguments[1], b.arguments[0], b.grads[0], b.arguments[2], b.arguments[3]},
              Rule{filter2d_kernel_backward_gradients, 0, false})[0];
  return gradients;
}

inline variable_list filter2d_kernel_backward_gradients(Backward const& b) {
  variable_list gradients(3);
  if (b.needs(1))
    gradients[1] =
        b.run("filter2d", {b.arguments[2], b.grads[0], b.arguments[3], b.arguments[4]}, Rule{filter2d_gradients})[0];
  if (b.needs(2))
    gradients[2] = b.run("filter2d_backward", {b.arguments[1], b.grads[0], b.arguments[3], b.arguments[4]},
                         Rule{filter2d_backward_gradients})[0];
  return gradients;
}

inline variable_list filter3d_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] = b.run("filter3d_backward", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]},
                         Rule{filter3d_backward_gradients})[0];
  if (b.needs(1))
    gradients[1] =
        b.run("filter3d_kernel_backward", {b.arguments[1], b.grads[0], b.arguments[0], b.arguments[2], b.arguments[3]},
              Rule{filter3d_kernel_backward_gradients, 0, false})[0];
  return gradients;
}

inline variable_list filter3d_backward_gradients(Backward const& b) {
  variable_list gradients(2);
  if (b.needs(0))
    gradients[0] =
        b.run("filter3d", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]}, Rule{filter3d_gradients})[0];
  if (b.needs(1))
    gradients[1] =
        b.run("filter3d_kernel_backward", {b.arguments[1], b.arguments[0], b.grads[0], b.arguments[2], b.arguments[3]},
              Rule{filter3d_kernel_backward_gradients, 0, false})[0];
  return gradients;
}

inline variable_list filter3d_kernel_backward_gradients(Backward const& b) {
  variable_list gradients(3);
  if (b.needs(1))
    gradients[1] =
        b.run("filter3d", {b.arguments[2], b.grads[0], b.arguments[3], b.arguments[4]}, Rule{filter3d_gradients})[0];
  if (b.needs(2))
    gradients[2] = b.run("filter3d_backward", {b.arguments[1], b.grads[0], b.arguments[3], b.arguments[4]},
                         Rule{filter3d_backward_gradients})[0];
  return gradients;
}

inline variable_list box_blur_gradients(Backward const& b) {
  return b.run("box_blur_backward", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]},
               Rule{box_blur_backward_gradients, 0, false});
}

inline variable_list box_blur_backward_gradients(Backward const& b) {
  return b.run("box_blur", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3]},
               Rule{box_blur_gradients, 0, false});
}

inline variable_list gaussian_blur2d_gradients(Backward const& b) {
  return b.run(
      "gaussian_blur2d_backward",
      {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5], b.arguments[6]},
      Rule{gaussian_blur2d_backward_gradients, 0, false});
}

inline variable_list gaussian_blur2d_backward_gradients(Backward const& b) {
  return b.run(
      "gaussian_blur2d",
      {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5], b.arguments[6]},
      Rule{gaussian_blur2d_gradients, 0, false});
}

inline variable_list median_blur_gradients(Backward const& b) {
  return b.run("median_blur_backward",
               {b.grads[0], b.arguments[0], b.results[0].detach(), b.arguments[1], b.arguments[2], b.arguments[3]},
               no_gradient);
}

inline variable_list unsharp_mask_gradients(Backward const& b) {
  return b.run(
      "unsharp_mask_backward",
      {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5], b.arguments[6]},
      Rule{unsharp_mask_backward_gradients, 0, false});
}

inline variable_list unsharp_mask_backward_gradients(Backward const& b) {
  return b.run(
      "unsharp_mask",
      {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5], b.arguments[6]},
      Rule{unsharp_mask_gradients, 0, false});
}

}  // namespace detail

}  // namespace kvision::ops
