// The filters. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/filters
// explains, and gradients. Images are (B, C, H, W), volumes (B, C, D, H, W), kernel sizes ky, kx, and `border` is one
// of "constant", "reflect", "replicate", "circular". Linear filters can be differentiated again and again; for the
// others, a second derivative is an error.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include <tuple>

#include "kvision/operator.h"

namespace kvision {

// --- edges -----------------------------------------------------------------------------------------------------------

inline Tensor sobel_backward(Tensor const& grad, Tensor const& input, bool normalized, double eps) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"sobel_backward">(grad, input, normalized, eps)}; };
  return differentiable({grad, input}, compute, {}, no_second_derivative("sobel"))[0];
}

inline Tensor sobel(Tensor const& input, bool normalized = true, double eps = 1e-6) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"sobel">(input, normalized, eps)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{sobel_backward(b.grads[0], b.saved[0], normalized, eps)};
  };
  return differentiable({input}, compute, {input}, gradient)[0];
}

Tensor spatial_gradient_backward(Tensor const& grad, std::string const& mode, int64_t order, bool normalized);

// (B, C, 2, H, W): d/dx, d/dy; or (B, C, 3, H, W) for order 2. mode: "sobel" or "diff".
inline Tensor spatial_gradient(Tensor const& input, std::string const& mode = "sobel", int64_t order = 1,
                               bool normalized = true) {
  auto const transpose = [=](Tensor const& g) { return spatial_gradient_backward(g, mode, order, normalized); };
  return detail::linear<"spatial_gradient">(input, transpose, mode, order, normalized);
}

inline Tensor spatial_gradient_backward(Tensor const& grad, std::string const& mode, int64_t order, bool normalized) {
  auto const transpose = [=](Tensor const& g) { return spatial_gradient(g, mode, order, normalized); };
  return detail::linear<"spatial_gradient_backward">(grad, transpose, mode, order, normalized);
}

Tensor spatial_gradient3d_backward(Tensor const& grad, int64_t order);

inline Tensor spatial_gradient3d(Tensor const& input, int64_t order = 1) {
  auto const transpose = [=](Tensor const& g) { return spatial_gradient3d_backward(g, order); };
  return detail::linear<"spatial_gradient3d">(input, transpose, order);
}

inline Tensor spatial_gradient3d_backward(Tensor const& grad, int64_t order) {
  auto const transpose = [=](Tensor const& g) { return spatial_gradient3d(g, order); };
  return detail::linear<"spatial_gradient3d_backward">(grad, transpose, order);
}

Tensor laplacian_backward(Tensor const& grad, int64_t ky, int64_t kx, bool normalized, std::string const& border);

inline Tensor laplacian(Tensor const& input, int64_t ky, int64_t kx, bool normalized = true,
                        std::string const& border = "reflect") {
  auto const transpose = [=](Tensor const& g) { return laplacian_backward(g, ky, kx, normalized, border); };
  return detail::linear<"laplacian">(input, transpose, ky, kx, normalized, border);
}

inline Tensor laplacian_backward(Tensor const& grad, int64_t ky, int64_t kx, bool normalized,
                                 std::string const& border) {
  auto const transpose = [=](Tensor const& g) { return laplacian(g, ky, kx, normalized, border); };
  return detail::linear<"laplacian_backward">(grad, transpose, ky, kx, normalized, border);
}

// Canny's edge magnitude where it is a ridge, else 0, and its edges: 1 above `high`, 0.5 above `low`, else 0. Only the
// magnitude has a gradient.
inline std::tuple<Tensor, Tensor> canny_suppress(Tensor const& input, double low, double high, double eps) {
  using namespace detail;
  auto const compute = [&] {
    auto [magnitude, edges] = call<"canny_suppress", std::tuple<Tensor, Tensor>>(input, low, high, eps);
    return variable_list{magnitude, edges};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const magnitude = std::get<0>(canny_suppress(b.saved[0].detach(), low, high, eps));
    return variable_list{sobel_backward(b.grads[0] * (magnitude > 0), b.saved[0], false, eps)};
  };
  variable_list const found = differentiable({input}, compute, {input}, gradient);
  return {found[0], found[1].detach()};
}

// 1 on strong edges (1) and on weak ones (0.5) that touch them, also through each other; else 0. No gradient.
inline Tensor canny_hysteresis(Tensor const& edges) {
  using namespace detail;
  return differentiable({}, [&] { return variable_list{call<"canny_hysteresis">(edges)}; }, {}, nullptr)[0];
}

// --- windows ---------------------------------------------------------------------------------------------------------

Tensor box_blur_backward(Tensor const& grad, int64_t ky, int64_t kx, std::string const& border);

inline Tensor box_blur(Tensor const& input, int64_t ky, int64_t kx, std::string const& border = "reflect") {
  auto const transpose = [=](Tensor const& g) { return box_blur_backward(g, ky, kx, border); };
  return detail::linear<"box_blur">(input, transpose, ky, kx, border);
}

inline Tensor box_blur_backward(Tensor const& grad, int64_t ky, int64_t kx, std::string const& border) {
  auto const transpose = [=](Tensor const& g) { return box_blur(g, ky, kx, border); };
  return detail::linear<"box_blur_backward">(grad, transpose, ky, kx, border);
}

inline Tensor median_blur_backward(Tensor const& grad, Tensor const& input, Tensor const& output, int64_t ky,
                                   int64_t kx, std::string const& border) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"median_blur_backward">(grad, input, output, ky, kx, border)}; };
  return differentiable({grad, input, output}, compute, {}, no_second_derivative("median_blur"))[0];
}

inline Tensor median_blur(Tensor const& input, int64_t ky, int64_t kx, std::string const& border = "reflect") {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"median_blur">(input, ky, kx, border)}; };
  auto const gradient = [=](Backward const& b) {
    Tensor const output = median_blur(b.saved[0].detach(), ky, kx, border);
    return variable_list{median_blur_backward(b.grads[0], b.saved[0], output, ky, kx, border)};
  };
  return differentiable({input}, compute, {input}, gradient)[0];
}

// The gradients to image and guidance; one that is not wanted has no channels.
inline std::tuple<Tensor, Tensor> bilateral_blur_backward(Tensor const& grad, Tensor const& input,
                                                          std::optional<Tensor> const& guidance,
                                                          std::optional<Tensor> const& sigma_color,
                                                          std::optional<Tensor> const& sigma_space, int64_t ky,
                                                          int64_t kx, double color, double space_y, double space_x,
                                                          std::string const& border, std::string const& distance,
                                                          bool wants_input, bool wants_guidance) {
  using namespace detail;
  auto const compute = [&] {
    auto [grad_input, grad_guidance] = call<"bilateral_blur_backward", std::tuple<Tensor, Tensor>>(
        grad, input, guidance, sigma_color, sigma_space, ky, kx, color, space_y, space_x, border, distance, wants_input,
        wants_guidance);
    return variable_list{grad_input, grad_guidance};
  };
  variable_list const tensors{grad, input, guidance.value_or(Tensor()), sigma_color.value_or(Tensor()),
                              sigma_space.value_or(Tensor())};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative("bilateral_blur"));
  return {found[0], found[1]};
}

// (B, 3, H): the gradients to (sigma_color, sigma_y, sigma_x) times sigma^3, row by row.
inline Tensor bilateral_blur_sigma_sums(Tensor const& grad, Tensor const& input, std::optional<Tensor> const& guidance,
                                        std::optional<Tensor> const& sigma_color,
                                        std::optional<Tensor> const& sigma_space, int64_t ky, int64_t kx, double color,
                                        double space_y, double space_x, std::string const& border,
                                        std::string const& distance) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"bilateral_blur_sigma_sums">(grad, input, guidance, sigma_color, sigma_space, ky, kx,
                                                           color, space_y, space_x, border, distance)};
  };
  variable_list const tensors{grad, input, guidance.value_or(Tensor()), sigma_color.value_or(Tensor()),
                              sigma_space.value_or(Tensor())};
  return differentiable(tensors, compute, {}, no_second_derivative("bilateral_blur"))[0];
}

// sigma_color: (B or 1), sigma_space: (B or 1, 2) in (y, x) order; without them the numbers count. With a guidance, its
// colours are compared in place of the input's. distance: "l1" or "l2".
inline Tensor bilateral_blur(Tensor const& input, std::optional<Tensor> const& guidance,
                             std::optional<Tensor> const& sigma_color, std::optional<Tensor> const& sigma_space,
                             int64_t ky, int64_t kx, double color, double space_y, double space_x,
                             std::string const& border = "reflect", std::string const& distance = "l1") {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"bilateral_blur">(input, guidance, sigma_color, sigma_space, ky, kx, color, space_y,
                                                space_x, border, distance)};
  };
  auto const gradient = [=](Backward const& b) {
    auto const given = [&](size_t i) { return b.saved[i].defined() ? std::optional(b.saved[i]) : std::nullopt; };
    Tensor const &x = b.saved[0], &g = b.grads[0];
    variable_list found(4);
    if (b.wanted(0) || b.wanted(1))
      std::tie(found[0], found[1]) = bilateral_blur_backward(g, x, given(1), given(2), given(3), ky, kx, color, space_y,
                                                             space_x, border, distance, b.wanted(0), b.wanted(1));
    if (b.wanted(2) || b.wanted(3)) {
      auto const wide = x.scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
      Tensor const sums = bilateral_blur_sigma_sums(g.to(wide), x.to(wide), given(1), given(2), given(3), ky, kx, color,
                                                    space_y, space_x, border, distance)
                              .sum(2);
      if (b.wanted(2)) found[2] = sums.select(1, 0) / b.saved[2].pow(3);
      if (b.wanted(3)) found[3] = sums.narrow(1, 1, 2) / b.saved[3].pow(3);
    }
    for (size_t i = 0; i < 4; ++i) found[i] = b.wanted(i) ? at::sum_to(found[i], b.saved[i].sizes()) : Tensor();
    return found;
  };
  variable_list const tensors{input, guidance.value_or(Tensor()), sigma_color.value_or(Tensor()),
                              sigma_space.value_or(Tensor())};
  return differentiable(tensors, compute, tensors, gradient)[0];
}

// --- any kernel ------------------------------------------------------------------------------------------------------

namespace detail {

// A filter, its transpose and its gradient to the kernel: the derivatives, for grad, input and kernel, of the sum over
// pixels of grad * filter(input, kernel), and so of each other.
template <Name filter, Name transpose, Name to_kernel>
struct Correlation {
  static Tensor forward(Tensor const& input, Tensor const& kernel, std::string const& border, bool same) {
    auto const compute = [&] { return variable_list{call<filter>(input, kernel, border, same)}; };
    auto const gradient = [=](Backward const& b) {
      Tensor const &x = b.saved[0], &k = b.saved[1], &g = b.grads[0];
      return variable_list{b.wanted(0) ? transposed(g, k, border, same) : Tensor(),
                           b.wanted(1) ? at::sum_to(kernel_gradient(k, g, x, border, same), k.sizes()) : Tensor()};
    };
    return differentiable({input, kernel}, compute, {input, kernel}, gradient)[0];
  }

  static Tensor transposed(Tensor const& grad, Tensor const& kernel, std::string const& border, bool same) {
    auto const compute = [&] { return variable_list{call<transpose>(grad, kernel, border, same)}; };
    auto const gradient = [=](Backward const& b) {
      Tensor const &g = b.saved[0], &k = b.saved[1], &x = b.grads[0];
      return variable_list{b.wanted(0) ? forward(x, k, border, same) : Tensor(),
                           b.wanted(1) ? at::sum_to(kernel_gradient(k, g, x, border, same), k.sizes()) : Tensor()};
    };
    return differentiable({grad, kernel}, compute, {grad, kernel}, gradient)[0];
  }

  static Tensor kernel_gradient(Tensor const& kernel, Tensor const& grad, Tensor const& input,
                                std::string const& border, bool same) {
    auto const compute = [&] { return variable_list{call<to_kernel>(kernel, grad, input, border, same)}; };
    auto const gradient = [=](Backward const& b) {
      Tensor const &g = b.saved[0], &x = b.saved[1], &k = b.grads[0];
      return variable_list{b.wanted(0) ? forward(x, k, border, same) : Tensor(),
                           b.wanted(1) ? transposed(g, k, border, same) : Tensor()};
    };
    return differentiable({grad, input}, compute, {grad, input}, gradient)[0];
  }
};

using Correlation2d = Correlation<"filter2d", "filter2d_backward", "filter2d_kernel_backward">;
using Correlation3d = Correlation<"filter3d", "filter3d_backward", "filter3d_kernel_backward">;

}  // namespace detail

// Kernels (B or 1, kH, kW) in the type that is computed in; same = false keeps only where the kernel fits inside.
inline Tensor filter2d(Tensor const& input, Tensor const& kernel, std::string const& border = "reflect",
                       bool same = true) {
  return detail::Correlation2d::forward(input, kernel, border, same);
}

inline Tensor filter2d_backward(Tensor const& grad, Tensor const& kernel, std::string const& border, bool same) {
  return detail::Correlation2d::transposed(grad, kernel, border, same);
}

// (B, kH, kW): the gradient to the kernel of each image; of `kernel` only sizes and type count.
inline Tensor filter2d_kernel_backward(Tensor const& kernel, Tensor const& grad, Tensor const& input,
                                       std::string const& border, bool same) {
  return detail::Correlation2d::kernel_gradient(kernel, grad, input, border, same);
}

// Kernels (B or 1, kD, kH, kW).
inline Tensor filter3d(Tensor const& input, Tensor const& kernel, std::string const& border = "replicate",
                       bool same = true) {
  return detail::Correlation3d::forward(input, kernel, border, same);
}

inline Tensor filter3d_backward(Tensor const& grad, Tensor const& kernel, std::string const& border, bool same) {
  return detail::Correlation3d::transposed(grad, kernel, border, same);
}

inline Tensor filter3d_kernel_backward(Tensor const& kernel, Tensor const& grad, Tensor const& input,
                                       std::string const& border, bool same) {
  return detail::Correlation3d::kernel_gradient(kernel, grad, input, border, same);
}

// --- separable kernels -----------------------------------------------------------------------------------------------

// (B, kW + kH): for each image the gradient to its kernel_x, then that to its kernel_y.
inline Tensor filter2d_separable_weights_backward(Tensor const& kernel_x, Tensor const& kernel_y, Tensor const& grad,
                                                  Tensor const& input, std::string const& border, bool same) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"filter2d_separable_weights_backward">(kernel_x, kernel_y, grad, input, border, same)};
  };
  auto const none = no_second_derivative("filter2d_separable's kernels");
  return differentiable({kernel_x, kernel_y, grad, input}, compute, {}, none)[0];
}

namespace detail {

// The gradients of filter2d_separable or of its transpose, `back` being the other of the two.
template <class Back>
variable_list separable_gradients(Backward const& b, Tensor const& grad, Tensor const& input, std::string const& border,
                                  bool same, Back back) {
  Tensor const &kernel_x = b.saved[1], &kernel_y = b.saved[2];
  variable_list found(3);
  if (b.wanted(0)) found[0] = back(b.grads[0], kernel_x, kernel_y, border, same);
  if (b.wanted(1) || b.wanted(2)) {
    Tensor const both = filter2d_separable_weights_backward(kernel_x, kernel_y, grad, input, border, same);
    variable_list const parts = both.split_with_sizes({kernel_x.size(1), kernel_y.size(1)}, 1);
    found[1] = at::sum_to(parts[0], kernel_x.sizes());
    found[2] = at::sum_to(parts[1], kernel_y.sizes());
  }
  return found;
}

}  // namespace detail

Tensor filter2d_separable_backward(Tensor const& grad, Tensor const& kernel_x, Tensor const& kernel_y,
                                   std::string const& border, bool same);

// Kernels (B or 1, size) in the type that is computed in.
inline Tensor filter2d_separable(Tensor const& input, Tensor const& kernel_x, Tensor const& kernel_y,
                                 std::string const& border = "reflect", bool same = true) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"filter2d_separable">(input, kernel_x, kernel_y, border, same)};
  };
  auto const gradient = [=](Backward const& b) {
    return separable_gradients(b, b.grads[0], b.saved[0], border, same, filter2d_separable_backward);
  };
  return differentiable({input, kernel_x, kernel_y}, compute, {input, kernel_x, kernel_y}, gradient)[0];
}

inline Tensor filter2d_separable_backward(Tensor const& grad, Tensor const& kernel_x, Tensor const& kernel_y,
                                          std::string const& border, bool same) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"filter2d_separable_backward">(grad, kernel_x, kernel_y, border, same)};
  };
  auto const gradient = [=](Backward const& b) {
    return separable_gradients(b, b.saved[0], b.grads[0], border, same, filter2d_separable);
  };
  return differentiable({grad, kernel_x, kernel_y}, compute, {grad, kernel_x, kernel_y}, gradient)[0];
}

namespace detail {

// The weights (B or 1, size) of a Gaussian for images `x`, from a column of sigmas (B or 1); differentiable.
inline Tensor gaussian_weights(Tensor const& x, Tensor const& sigma, int64_t size) {
  Tensor const wide = sigma.to(at::kDouble).unsqueeze(1), distance = at::arange(size, wide.options()) - size / 2;
  Tensor const weights = at::exp(-distance.square() / (2 * wide.square()));
  return (weights / weights.sum(1, true)).to(x.scalar_type() == at::kDouble ? at::kDouble : at::kFloat);
}

inline bool is_variable(std::optional<Tensor> const& x) {
  return x && x->requires_grad() && at::GradMode::is_enabled();
}

// gaussian_blur2d whose sigma wants a gradient: a filter with weights that have one.
inline Tensor gaussian_of_variable(Tensor const& input, Tensor const& sigma, int64_t ky, int64_t kx,
                                   std::string const& border) {
  Tensor const kernel_y = gaussian_weights(input, sigma.select(1, 0), ky);
  Tensor const kernel_x = gaussian_weights(input, sigma.select(1, 1), kx);
  return filter2d_separable(input, kernel_x, kernel_y, border, true);
}

}  // namespace detail

Tensor gaussian_blur2d_backward(Tensor const& grad, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                                double sigma_y, double sigma_x, std::string const& border);

// sigma: (B or 1, 2) in (y, x) order; without it the two numbers count.
inline Tensor gaussian_blur2d(Tensor const& input, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                              double sigma_y, double sigma_x, std::string const& border = "reflect") {
  if (detail::is_variable(sigma)) return detail::gaussian_of_variable(input, *sigma, ky, kx, border);
  auto const transpose = [=](Tensor const& g) {
    return gaussian_blur2d_backward(g, sigma, ky, kx, sigma_y, sigma_x, border);
  };
  return detail::linear<"gaussian_blur2d">(input, transpose, sigma, ky, kx, sigma_y, sigma_x, border);
}

inline Tensor gaussian_blur2d_backward(Tensor const& grad, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                                       double sigma_y, double sigma_x, std::string const& border) {
  auto const transpose = [=](Tensor const& g) { return gaussian_blur2d(g, sigma, ky, kx, sigma_y, sigma_x, border); };
  return detail::linear<"gaussian_blur2d_backward">(grad, transpose, sigma, ky, kx, sigma_y, sigma_x, border);
}

Tensor unsharp_mask_backward(Tensor const& grad, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                             double sigma_y, double sigma_x, std::string const& border);

inline Tensor unsharp_mask(Tensor const& input, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                           double sigma_y, double sigma_x, std::string const& border = "reflect") {
  if (detail::is_variable(sigma)) return 2 * input - detail::gaussian_of_variable(input, *sigma, ky, kx, border);
  auto const transpose = [=](Tensor const& g) {
    return unsharp_mask_backward(g, sigma, ky, kx, sigma_y, sigma_x, border);
  };
  return detail::linear<"unsharp_mask">(input, transpose, sigma, ky, kx, sigma_y, sigma_x, border);
}

inline Tensor unsharp_mask_backward(Tensor const& grad, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                                    double sigma_y, double sigma_x, std::string const& border) {
  auto const transpose = [=](Tensor const& g) { return unsharp_mask(g, sigma, ky, kx, sigma_y, sigma_x, border); };
  return detail::linear<"unsharp_mask_backward">(grad, transpose, sigma, ky, kx, sigma_y, sigma_x, border);
}

}  // namespace kvision
