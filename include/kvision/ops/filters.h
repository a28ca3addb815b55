// The filters. Arguments are those of torch.ops.kvision.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops {

// --- edges -----------------------------------------------------------------------------------------------------------

inline constexpr Operator<"sobel", Tensor(Tensor input, bool normalized, double eps)> sobel{from<"sobel_backward">};
inline constexpr Operator<"spatial_gradient", Tensor(Tensor input, int64_t mode, int64_t order, bool normalized)>
    spatial_gradient{linear};
inline constexpr Operator<"spatial_gradient3d", Tensor(Tensor input, int64_t order)> spatial_gradient3d{linear};
inline constexpr Operator<"laplacian", Tensor(Tensor input, int64_t ky, int64_t kx, bool normalized, int64_t border)>
    laplacian{linear};
inline constexpr Operator<"canny_suppress", Two(Tensor input, double low, double high, double eps)> canny_suppress{
    [](Backward const& b) -> variable_list {
      return b.call("sobel_backward", {{"grad", b.grad() * (b.results[0] > 0)}, {"normalized", false}});
    },
    2};
inline constexpr Operator<"canny_hysteresis", Tensor(Tensor edges)> canny_hysteresis{non_differentiable};

// --- windows ---------------------------------------------------------------------------------------------------------

inline constexpr Operator<"box_blur", Tensor(Tensor input, int64_t ky, int64_t kx, int64_t border)> box_blur{linear};
inline constexpr Operator<"gaussian_blur2d", Tensor(Tensor input, OptionalTensor sigma, int64_t ky, int64_t kx,
                                                    double sigma_y, double sigma_x, int64_t border)>
    gaussian_blur2d{linear};
inline constexpr Operator<"motion_kernel", Tensor(Tensor angle, Tensor direction, int64_t size, int64_t taps)>
    motion_kernel;
inline constexpr Operator<"gaussian_levels", Tensor(Tensor input, Ints sizes, Floats sigmas, int64_t border)>
    gaussian_levels{{[](Backward const& b) -> variable_list {
                       Ints const sizes = b.arguments[1].toIntVector();
                       Floats const sigmas = b.arguments[2].toDoubleVector();
                       Tensor grad = b.grad().select(2, int64_t(sizes.size()));
                       for (size_t i = sizes.size(); i-- > 0;)
                         grad = b.grad().select(2, int64_t(i)) +
                                b.call("gaussian_blur2d_backward", {{"grad", grad},
                                                                    {"sigma", c10::IValue()},
                                                                    {"ky", sizes[i]},
                                                                    {"kx", sizes[i]},
                                                                    {"sigma_y", sigmas[i]},
                                                                    {"sigma_x", sigmas[i]}})[0];
                       return {grad};
                     },
                     0, false}};
inline constexpr Operator<"unsharp_mask", Tensor(Tensor input, OptionalTensor sigma, int64_t ky, int64_t kx,
                                                 double sigma_y, double sigma_x, int64_t border)>
    unsharp_mask{linear};
inline constexpr Operator<"median_blur", Tensor(Tensor input, int64_t ky, int64_t kx, int64_t border)> median_blur{
    from<"median_blur_backward", 1>};
inline constexpr Operator<"bilateral_blur", Tensor(Tensor input, OptionalTensor guidance, OptionalTensor sigma_color,
                                                   OptionalTensor sigma_space, int64_t ky, int64_t kx, double color,
                                                   double space_y, double space_x, int64_t border, int64_t distance)>
    bilateral_blur{[](Backward const& b) -> variable_list {
      variable_list gradients(4);
      if (b.needs(0) || b.needs(1)) {
        variable_list const images =
            b.call("bilateral_blur_backward", {{"wants_input", b.needs(0)}, {"wants_guidance", b.needs(1)}});
        std::copy(images.begin(), images.end(), gradients.begin());
      }
      if (b.needs(2) || b.needs(3)) {
        Tensor const x = b.tensor(0);
        auto const type = x.scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
        Tensor const sums =
            b.call("bilateral_blur_sigma_sums", {{"grad", b.grad().to(type)}, {"input", x.to(type)}})[0].sum(2);
        if (b.needs(2)) gradients[2] = sums.select(1, 0) / b.tensor(2).pow(3);
        if (b.needs(3)) gradients[3] = sums.narrow(1, 1, 2) / b.tensor(3).pow(3);
      }
      return gradients;
    }};

// --- kernels ---------------------------------------------------------------------------------------------------------

namespace detail {

// A filter (input, kernel), its transpose (grad, kernel) and its gradient to the kernel (grad, input) are the
// derivatives of the sum over pixels of grad * filter(input, kernel), and so of each other: what comes back to one of
// them plays the role of its result in the two others.
inline constexpr Rule correlation{[](Backward const& b) -> variable_list {
  std::string const name = name_of(b.op), filter = name.substr(0, name.find("_"));
  std::string const transpose = filter + "_backward", kernel_gradient = filter + "_kernel_backward";
  char const* const role = name == filter ? "grad" : name == transpose ? "input" : "kernel";
  auto const to = [&](size_t i, std::string const& op) {
    return b.needs(i) ? b.call(op, {{role, b.grad()}}, correlation)[0] : Tensor();
  };
  if (name == kernel_gradient) return {Tensor(), to(1, filter), to(2, transpose)};
  return {to(0, name == filter ? transpose : filter), to(1, kernel_gradient)};
}};

}  // namespace detail

inline constexpr Operator<"filter2d", Tensor(Tensor input, Tensor kernel, int64_t border, bool same)> filter2d{
    detail::correlation};
inline constexpr Operator<"filter3d", Tensor(Tensor input, Tensor kernel, int64_t border, bool same)> filter3d{
    detail::correlation};

namespace detail {

// Of filter2d_separable (input, kernels) and its transpose (grad, kernels).
inline constexpr Rule separable{[](Backward const& b) -> variable_list {
  bool const is_transpose = name_of(b.op) == "filter2d_separable_backward";
  char const* const other = is_transpose ? "filter2d_separable" : "filter2d_separable_backward";
  char const* const role = is_transpose ? "input" : "grad";
  variable_list gradients{b.needs(0) ? b.call(other, {{role, b.grad()}}, separable)[0] : Tensor()};
  if (b.needs(1) || b.needs(2)) {
    Tensor const kernels = b.call("filter2d_separable_weights_backward", {{role, b.grad()}})[0];
    for (Tensor const& part : kernels.split_with_sizes({b.tensor(1).size(1), b.tensor(2).size(1)}, 1))
      gradients.push_back(part);
  }
  return gradients;
}};

}  // namespace detail

inline constexpr Operator<"filter2d_separable",
                          Tensor(Tensor input, Tensor kernel_x, Tensor kernel_y, int64_t border, bool same)>
    filter2d_separable{detail::separable};

}  // namespace kvision::ops
