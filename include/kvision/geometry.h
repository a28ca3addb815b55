// Warps and resizing. Each function has the arguments of the operator torch.ops.kvision.<name>, which
// python/kvision/geometry/transform explains, and gradients. Images are (B, C, H, W); matrices (B or 1, 3, 3) or (B or
// 1, 2, 3), maps (B or 1, H, W) and fills (B or 1, C or 1), in float32, for float64 images in float64. interpolation:
// "nearest", "bilinear" or "bicubic"; padding: "fill", "border" or "reflection". A second derivative
// of a warp is an error.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include <initializer_list>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "kvision/matrices.h"
#include "kvision/operator.h"

namespace kvision {

namespace detail {

// Gradients to images are summed in the type that computes.
inline Tensor computed(Tensor const& x) { return x.scalar_type() == at::kDouble ? x : x.to(at::kFloat); }

inline std::vector<int64_t> image_size(Tensor const& x) { return {x.size(2), x.size(3)}; }

// What one argument gets that served all samples.
inline Tensor summed_to(Tensor const& grad, Tensor const& like) {
  return like.size(0) < grad.size(0) ? grad.sum(0, true) : grad;
}

inline Tensor to_fill(Tensor const& grad, Tensor const& inside, Tensor const& fill) {
  return at::sum_to(((1 - inside) * grad).to(fill.scalar_type()).sum({2, 3}), fill.sizes());
}

}  // namespace detail

inline Tensor warp_image_gradient(Tensor const& grad, Tensor const& matrix, std::vector<int64_t> const& size,
                                  std::string const& interpolation, std::string const& padding, bool align_corners,
                                  bool inverse, bool normalized) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"warp_image_gradient">(grad, matrix, size, interpolation, padding, align_corners, inverse, normalized)};
  };
  return differentiable({grad, matrix}, compute, {}, no_second_derivative("warp"))[0];
}

// For each sample, also where one matrix serves all.
inline Tensor warp_matrix_gradient(Tensor const& grad, Tensor const& image, Tensor const& matrix,
                                   std::optional<Tensor> const& fill, std::string const& interpolation,
                                   std::string const& padding, bool align_corners, bool inverse, bool normalized) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"warp_matrix_gradient">(grad, image, matrix, fill, interpolation, padding, align_corners,
                                                      inverse, normalized)};
  };
  variable_list const tensors{grad, image, matrix, fill.value_or(Tensor())};
  return differentiable(tensors, compute, {}, no_second_derivative("warp"))[0];
}

// The image at the places that a matrix gives: `matrix` from pixels of the result (x, y, 1) to pixels of the image, or
// the other way round with `inverse`, or between [-1, 1] with `normalized`. What is outside is `fill`, or 0 without it.
inline Tensor warp(Tensor const& image, Tensor const& matrix, std::optional<Tensor> const& fill,
                   std::vector<int64_t> const& size, std::string const& interpolation = "bilinear",
                   std::string const& padding = "fill", bool align_corners = true, bool inverse = true,
                   bool normalized = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"warp">(image, matrix, fill, size, interpolation, padding, align_corners, inverse, normalized)};
  };
  Tensor const given = fill.value_or(Tensor());
  auto const gradient = [=](Backward const& b) {
    Tensor const &grad = b.grads[0], &x = b.saved[0], &m = b.saved[1], &f = b.saved[2];
    std::optional<Tensor> const filled = f.defined() ? std::optional(f) : std::nullopt;
    variable_list found(3);
    if (b.wanted(0))
      found[0] =
          warp_image_gradient(grad, m, image_size(x), interpolation, padding, align_corners, inverse, normalized);
    if (b.wanted(1))
      found[1] = summed_to(
          warp_matrix_gradient(grad, x, m, filled, interpolation, padding, align_corners, inverse, normalized), m);
    if (b.wanted(2))
      found[2] = to_fill(grad,
                         warp(at::ones_like(x.narrow(1, 0, 1)), m, std::nullopt, size, interpolation, padding,
                              align_corners, inverse, normalized),
                         f);
    return found;
  };
  return differentiable({image, matrix, given}, compute, {image, matrix, given}, gradient)[0];
}

namespace detail {

// A tensor of a formula that it needs.
inline Tensor const& needed(std::optional<Tensor> const& x, std::string const& formula) {
  TORCH_CHECK(x, formula, ": expected its first tensor");
  return *x;
}

// Whether a gradient is wanted to images or to what a formula is given.
inline bool wants_gradient(Tensor const& images, std::initializer_list<std::optional<Tensor>> given) {
  variable_list tensors{images};
  for (std::optional<Tensor> const& x : given) tensors.push_back(x.value_or(Tensor()));
  return wants_gradient(tensors);
}

// The translation of a formula, which there may be none of, for an image.
inline Tensor translation_of(std::optional<Tensor> const& x, Tensor const& image, int64_t axes) {
  auto const type = image.scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
  return x ? *x : at::zeros({1, axes}, image.options().dtype(type));
}

}  // namespace detail

// `warp` by the matrix of a formula of matrices.h, which is made where it is used: affine_matrix2d,
// translation_matrix2d, scale_matrix2d, slant_matrix2d or crop_matrix, of its tensors and its numbers but `rows`.
inline Tensor warp_by_formula(Tensor const& image, std::optional<Tensor> const& a, std::optional<Tensor> const& b,
                              std::optional<Tensor> const& c, std::optional<Tensor> const& d,
                              std::optional<Tensor> const& e, std::optional<Tensor> const& f,
                              std::string const& formula, std::vector<double> const& numbers,
                              std::vector<int64_t> const& size, std::string const& interpolation = "bilinear",
                              std::string const& padding = "fill", bool align_corners = true, bool inverse = true,
                              bool normalized = false) {
  using namespace detail;
  if (wants_gradient(image, {a, b, c, d, e, f})) {
    auto const number = [&](size_t i) { return numbers.at(i); };
    auto const matrix = [&] {
      if (formula == "affine_matrix2d")
        return affine_matrix2d(needed(a, formula), b, c, d, e, f, number(0), number(1), number(2), 2);
      if (formula == "translation_matrix2d")
        return translation_matrix2d(translation_of(a, image, 2), number(0), number(1), 2);
      if (formula == "scale_matrix2d") return scale_matrix2d(needed(a, formula), b, number(0), number(1));
      if (formula == "slant_matrix2d") return slant_matrix2d(needed(a, formula));
      TORCH_CHECK(formula == "crop_matrix", "warp_by_formula: no formula of images is called '", formula, "'");
      return crop_matrix(needed(a, formula), b, number(0), number(1));
    };
    return warp(image, matrix(), std::nullopt, size, interpolation, padding, align_corners, inverse, normalized);
  }
  at::AutoDispatchBelowADInplaceOrView below_autograd;
  return call<"warp_by_formula">(image, a, b, c, d, e, f, formula, numbers, size, interpolation, padding, align_corners,
                                 inverse, normalized);
}

inline Tensor remap_image_gradient(Tensor const& grad, Tensor const& map_x, Tensor const& map_y,
                                   std::vector<int64_t> const& size, std::string const& interpolation,
                                   std::string const& padding, bool align_corners, bool normalized,
                                   bool moves = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"remap_image_gradient">(grad, map_x, map_y, size, interpolation, padding, align_corners,
                                                      normalized, moves)};
  };
  return differentiable({grad, map_x, map_y}, compute, {}, no_second_derivative("remap"))[0];
}

// For each sample, also where one map serves all.
inline std::tuple<Tensor, Tensor> remap_map_gradient(Tensor const& grad, Tensor const& image, Tensor const& map_x,
                                                     Tensor const& map_y, std::optional<Tensor> const& fill,
                                                     std::string const& interpolation, std::string const& padding,
                                                     bool align_corners, bool normalized, bool moves = false) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_x, to_y] = call<"remap_map_gradient", std::tuple<Tensor, Tensor>>(
        grad, image, map_x, map_y, fill, interpolation, padding, align_corners, normalized, moves);
    return variable_list{to_x, to_y};
  };
  variable_list const tensors{grad, image, map_x, map_y, fill.value_or(Tensor())};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative("remap"));
  return {found[0], found[1]};
}

// The image at the places of a map, in pixels, or in [-1, 1] with `normalized`; with `moves` at what it says beside
// each pixel's own place.
inline Tensor remap(Tensor const& image, Tensor const& map_x, Tensor const& map_y, std::optional<Tensor> const& fill,
                    std::string const& interpolation = "bilinear", std::string const& padding = "fill",
                    bool align_corners = true, bool normalized = false, bool moves = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"remap">(image, map_x, map_y, fill, interpolation, padding, align_corners, normalized, moves)};
  };
  Tensor const given = fill.value_or(Tensor());
  auto const gradient = [=](Backward const& b) {
    Tensor const &grad = b.grads[0], &x = b.saved[0], &u = b.saved[1], &v = b.saved[2], &f = b.saved[3];
    std::optional<Tensor> const filled = f.defined() ? std::optional(f) : std::nullopt;
    variable_list found(4);
    if (b.wanted(0))
      found[0] =
          remap_image_gradient(grad, u, v, image_size(x), interpolation, padding, align_corners, normalized, moves);
    if (b.wanted(1) || b.wanted(2)) {
      auto const [to_x, to_y] =
          remap_map_gradient(grad, x, u, v, filled, interpolation, padding, align_corners, normalized, moves);
      found[1] = summed_to(to_x, u);
      found[2] = summed_to(to_y, v);
    }
    if (b.wanted(3))
      found[3] = to_fill(grad,
                         remap(at::ones_like(x.narrow(1, 0, 1)), u, v, std::nullopt, interpolation, padding,
                               align_corners, normalized, moves),
                         f);
    return found;
  };
  return differentiable({image, map_x, map_y, given}, compute, {image, map_x, map_y, given}, gradient)[0];
}

// Gradients to centers, weights and affine, each for every sample, also where one serves all.
inline variable_list spline_map_backward(Tensor const& grad, Tensor const& centers, Tensor const& weights,
                                         Tensor const& affine, bool align_corners) {
  using namespace detail;
  auto const compute = [&] {
    auto [c, w, a] =
        call<"spline_map_backward", std::tuple<Tensor, Tensor, Tensor>>(grad, centers, weights, affine, align_corners);
    return variable_list{c, w, a};
  };
  return differentiable({grad, centers, weights, affine}, compute, {}, no_second_derivative("spline_map"));
}

// To points, centers, weights and affine.
inline variable_list spline_points_backward(Tensor const& grad, Tensor const& points, Tensor const& centers,
                                            Tensor const& weights, Tensor const& affine) {
  using namespace detail;
  auto const compute = [&] {
    auto [p, c, w, a] = call<"spline_points_backward", std::tuple<Tensor, Tensor, Tensor, Tensor>>(
        grad, points, centers, weights, affine);
    return variable_list{p, c, w, a};
  };
  return differentiable({grad, points, centers, weights, affine}, compute, {}, no_second_derivative("spline_points"));
}

// Where a thin-plate spline of kernels around `centers` (B, N, 2), with `weights` (B, N, 2) and an `affine` part
// (B, 3, 2), takes points (B, M, 2).
inline Tensor spline_points(Tensor const& points, Tensor const& centers, Tensor const& weights, Tensor const& affine) {
  using namespace detail;
  variable_list const given{points, centers, weights, affine};
  auto const compute = [&] { return variable_list{call<"spline_points">(points, centers, weights, affine)}; };
  auto const gradient = [](Backward const& b) {
    variable_list const& x = b.saved;
    variable_list found = spline_points_backward(b.grads[0], x[0], x[1], x[2], x[3]);
    for (size_t i = 0; i < found.size(); ++i) found[i] = summed_to(found[i], x[i]);
    return found;
  };
  return differentiable(given, compute, given, gradient)[0];
}

// Where it takes the pixels of an image of that size, in [-1, 1]: (B, 2, h, w), as `remap` takes them.
inline Tensor spline_map(Tensor const& centers, Tensor const& weights, Tensor const& affine,
                         std::vector<int64_t> const& size, bool align_corners = false) {
  using namespace detail;
  variable_list const given{centers, weights, affine};
  auto const compute = [&] { return variable_list{call<"spline_map">(centers, weights, affine, size, align_corners)}; };
  auto const gradient = [=](Backward const& b) {
    variable_list const& x = b.saved;
    variable_list found = spline_map_backward(b.grads[0], x[0], x[1], x[2], align_corners);
    for (size_t i = 0; i < found.size(); ++i) found[i] = summed_to(found[i], x[i]);
    return found;
  };
  return differentiable(given, compute, given, gradient)[0];
}

// The weights of a spline and then its affine part, (B, N + 3, 2), with values `right` (B, N + 3, 2) at its centers and
// three zeros.
inline Tensor spline_weights(Tensor const& centers, Tensor const& right) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"spline_weights">(centers, right)}; };
  // The system is symmetric, and what it multiplies is the spline at its own centers, and its weights' sums.
  auto const gradient = [](Backward const& b) {
    Tensor const &x = b.saved[0], &values = b.saved[1];
    int64_t const n = x.size(1);
    variable_list found(2);
    Tensor const to_right = spline_weights(x, b.grads[0]);
    if (b.wanted(0)) {
      Tensor const both = spline_weights(x, values), weights = both.narrow(1, 0, n), to = to_right.narrow(1, 0, n);
      variable_list const at = spline_points_backward(to, x, x, weights, both.narrow(1, n, 3));
      found[0] = summed_to(-(at[0] + at[1] + weights.matmul(to_right.narrow(1, n + 1, 2).mT())), x);
    }
    if (b.wanted(1)) found[1] = summed_to(to_right, values);
    return found;
  };
  return differentiable({centers, right}, compute, {centers, right}, gradient)[0];
}

Tensor resize_backward(Tensor const& grad, std::vector<int64_t> const& size, std::string const& window,
                       bool align_corners, bool antialias, std::string const& border);

// `window` is "nearest", "nearest-exact", "area", "bilinear", "bicubic", "lanczos", or "pyrdown" or "pyrup" with a
// `border` that is not "circular".
inline Tensor resize(Tensor const& input, std::vector<int64_t> const& size, std::string const& window = "bilinear",
                     bool align_corners = false, bool antialias = false, std::string const& border = "reflect") {
  auto const transpose = [=, source = detail::image_size(input)](Tensor const& g) {
    return resize_backward(g, source, window, align_corners, antialias, border);
  };
  return detail::linear<"resize">(input, transpose, size, window, align_corners, antialias, border);
}

inline Tensor resize_backward(Tensor const& grad, std::vector<int64_t> const& size, std::string const& window,
                              bool align_corners, bool antialias, std::string const& border) {
  auto const transpose = [=, result = detail::image_size(grad)](Tensor const& g) {
    return resize(g, result, window, align_corners, antialias, border);
  };
  return detail::linear<"resize_backward">(grad, transpose, size, window, align_corners, antialias, border);
}

// What an image has that the next smaller one of its pyramid has not: image - pyrup(smaller).
inline Tensor pyramid_detail(Tensor const& smaller, Tensor const& image, bool align_corners = false,
                             std::string const& border = "reflect") {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"pyramid_detail">(smaller, image, align_corners, border)}; };
  auto const gradient = [=, size = image_size(smaller)](Backward const& b) {
    variable_list found(2);
    if (b.wanted(0)) found[0] = -resize_backward(b.grads[0], size, "pyrup", align_corners, false, border);
    if (b.wanted(1)) found[1] = b.grads[0];
    return found;
  };
  return differentiable({smaller, image}, compute, {}, gradient)[0];
}

// Columns, rows or both reversed; neither is a copy.
inline Tensor flip(Tensor const& input, bool columns, bool rows) {
  auto const transpose = [=](Tensor const& g) { return flip(g, columns, rows); };
  return detail::linear<"flip">(input, transpose, columns, rows);
}

// The pixels of a rectangle whose first one is at `corner` (row, column); zeros where it reaches outside.
inline Tensor window(Tensor const& input, std::vector<int64_t> const& corner, std::vector<int64_t> const& size) {
  auto const transpose = [=, source = detail::image_size(input)](Tensor const& g) {
    return window(g, {-corner[0], -corner[1]}, source);
  };
  return detail::linear<"window">(input, transpose, corner, size);
}

// For each sample, also where one matrix serves all.
inline Tensor warp3d_matrix_gradient(Tensor const& grad, Tensor const& volumes, Tensor const& matrix,
                                     std::string const& interpolation, std::string const& padding, bool align_corners,
                                     bool inverse, bool normalized) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"warp3d_matrix_gradient">(grad, volumes, matrix, interpolation, padding, align_corners,
                                                        inverse, normalized)};
  };
  return differentiable({grad, volumes, matrix}, compute, {}, no_second_derivative("warp3d"))[0];
}

inline Tensor warp3d_volume_gradient(Tensor const& grad, Tensor const& matrix, std::vector<int64_t> const& size,
                                     std::string const& interpolation, std::string const& padding, bool align_corners,
                                     bool inverse, bool normalized) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"warp3d_volume_gradient">(grad, matrix, size, interpolation, padding, align_corners, inverse, normalized)};
  };
  return differentiable({grad, matrix}, compute, {}, no_second_derivative("warp3d"))[0];
}

// Volumes (B, C, D, H, W) at the places that matrices (B or 1, 4, 4) or (B or 1, 3, 4) give, as `warp` does: "nearest"
// or "bilinear", zeros outside with "fill".
inline Tensor warp3d(Tensor const& volumes, Tensor const& matrix, std::vector<int64_t> const& size,
                     std::string const& interpolation = "bilinear", std::string const& padding = "fill",
                     bool align_corners = true, bool inverse = true, bool normalized = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"warp3d">(volumes, matrix, size, interpolation, padding, align_corners, inverse, normalized)};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const &x = b.saved[0], &m = b.saved[1], grad = b.grads[0].to(m.scalar_type());
    variable_list found(2);
    if (b.wanted(0))
      found[0] = warp3d_volume_gradient(grad, m, {x.size(2), x.size(3), x.size(4)}, interpolation, padding,
                                        align_corners, inverse, normalized)
                     .to(x.scalar_type());
    if (b.wanted(1))
      found[1] = summed_to(warp3d_matrix_gradient(grad, x.to(m.scalar_type()), m, interpolation, padding, align_corners,
                                                  inverse, normalized),
                           m);
    return found;
  };
  return differentiable({volumes, matrix}, compute, {volumes, matrix}, gradient)[0];
}

// `warp3d` by the matrix of a formula of matrices.h: affine_matrix3d without shears, translation_matrix3d or
// perspective_matrix3d, of its tensors and its numbers but `rows`.
inline Tensor warp3d_by_formula(Tensor const& volumes, std::optional<Tensor> const& a, std::optional<Tensor> const& b,
                                std::optional<Tensor> const& c, std::optional<Tensor> const& d,
                                std::optional<Tensor> const& e, std::optional<Tensor> const& f,
                                std::string const& formula, std::vector<double> const& numbers,
                                std::vector<int64_t> const& size, std::string const& interpolation = "bilinear",
                                std::string const& padding = "fill", bool align_corners = true, bool inverse = true,
                                bool normalized = false) {
  using namespace detail;
  if (wants_gradient(volumes, {a, b, c, d, e, f})) {
    auto const number = [&](size_t i) { return numbers.at(i); };
    auto const matrix = [&] {
      if (formula == "affine_matrix3d")
        return affine_matrix3d(needed(a, formula), needed(b, formula), needed(c, formula), d, e, f, {}, {}, {}, {}, {},
                               {}, number(0), number(1), number(2), number(3), 3);
      if (formula == "translation_matrix3d")
        return translation_matrix3d(translation_of(a, volumes, 3), number(0), number(1), number(2), 3);
      TORCH_CHECK(formula == "perspective_matrix3d", "warp3d_by_formula: no formula of volumes is called '", formula,
                  "'");
      return perspective_matrix3d(needed(a, formula), b, number(0), number(1), number(2));
    };
    return warp3d(volumes, matrix(), size, interpolation, padding, align_corners, inverse, normalized);
  }
  at::AutoDispatchBelowADInplaceOrView below_autograd;
  return call<"warp3d_by_formula">(volumes, a, b, c, d, e, f, formula, numbers, size, interpolation, padding,
                                   align_corners, inverse, normalized);
}

// The mean distance of `target` from `source` warped by `matrix`, from the target's places to the source's; (B). It has
// a gradient to the matrix alone. distance: "l1", "l2" or "charbonnier".
inline Tensor photometric(Tensor const& source, Tensor const& target, Tensor const& matrix,
                          std::string const& distance = "l1", double eps = 1e-3, bool align_corners = false,
                          bool normalized = true) {
  using namespace detail;
  auto const [loss, slope] = [&] {
    at::NoGradGuard no_grad;
    return call<"photometric", std::tuple<Tensor, Tensor>>(source, target, matrix.detach(), distance, eps,
                                                           align_corners, normalized);
  }();
  auto const compute = [&] { return variable_list{loss}; };
  auto const gradient = [](Backward const& b) {
    Tensor const &grad = b.grads[0], &slopes = b.saved[0], &m = b.saved[1];
    auto const found = [&] { return variable_list{summed_to(grad.view({-1, 1, 1}) * slopes, m)}; };
    return differentiable({grad, m}, found, {}, no_second_derivative("photometric"));
  };
  return differentiable({matrix}, compute, {slope, matrix}, gradient)[0];
}

// The normal equations (B, 8, 8), the gradient (B, 8) and the distance (B) of a step of Gauss and Newton; without
// gradients.
inline std::tuple<Tensor, Tensor, Tensor> photometric_normal(Tensor const& source, Tensor const& target,
                                                             Tensor const& matrix, std::string const& distance = "l1",
                                                             double eps = 1e-3, bool align_corners = false,
                                                             bool normalized = true) {
  at::NoGradGuard no_grad;
  return detail::call<"photometric_normal", std::tuple<Tensor, Tensor, Tensor>>(source, target, matrix, distance, eps,
                                                                                align_corners, normalized);
}

// The gradient to the matrix is of each sample, also where one matrix serves all; without `to_matrix` it has no rows.
inline std::tuple<Tensor, Tensor, Tensor> map_points_backward(Tensor const& grad, Tensor const& points,
                                                              std::optional<Tensor> const& depth, Tensor const& matrix,
                                                              std::string const& kind, bool to_matrix) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_points, to_depth, sums] =
        call<"map_points_backward", std::tuple<Tensor, Tensor, Tensor>>(grad, points, depth, matrix, kind, to_matrix);
    return variable_list{to_points, to_depth, sums};
  };
  variable_list const tensors{grad, points, depth.value_or(Tensor()), matrix};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative("map_points"));
  return {found[0], found[1], found[2]};
}

// Points (B, N, D) by matrices (B or 1, ., .), in float32, for float64 points in float64. kind: "transform" by
// homographies (D + 1, D + 1) or projections (3, 4); by camera matrices (3, 3) "project" to pixels, or "unproject"
// pixels at `depth` (B, N, 1), which is z, or for "unproject_distance" the distance. "meet" gives the depth at which
// rays through pixels meet a plane n . p = d, by rows (1, 9): fx, fy, cx, cy, n, d, and the least of n . ray but for
// its sign.
inline Tensor map_points(Tensor const& points, std::optional<Tensor> const& depth, Tensor const& matrix,
                         std::string const& kind) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"map_points">(points, depth, matrix, kind)}; };
  Tensor const given = depth.value_or(Tensor());
  auto const gradient = [=](Backward const& b) {
    Tensor const &p = b.saved[0], &d = b.saved[1], &m = b.saved[2];
    std::optional<Tensor> const at = d.defined() ? std::optional(d) : std::nullopt;
    auto const [to_points, to_depth, sums] = map_points_backward(b.grads[0], p, at, m, kind, b.wanted(2));
    return variable_list{to_points, d.defined() ? to_depth : Tensor(), b.wanted(2) ? summed_to(sums, m) : Tensor()};
  };
  return differentiable({points, given, matrix}, compute, {points, given, matrix}, gradient)[0];
}

}  // namespace kvision
