// Lenses and poses from points, as python/kvision/geometry/calibration has them. Points are (B, N, 2), camera matrices
// (B or 1, 3, 3), and dist the first 4, 5, 8, 12 or 14 of k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tx, ty.
#pragma once

#include <torch/csrc/autograd/autograd.h>

#include <limits>

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

// The matrix (B, 3, 3) to the plane of a tilted sensor, by angles (B,), or back.
inline Tensor tilt_projection(Tensor const& taux, Tensor const& tauy, bool return_inverse = false) {
  Tensor const cx = taux.cos(), sx = taux.sin(), cy = tauy.cos(), sy = tauy.sin(), zero = at::zeros_like(cx),
               one = at::ones_like(cx), x = -sy * cx, y = sx, z = cy * cx;
  auto const matrix = [](std::vector<Tensor> const& entries) { return at::stack(entries, -1).unflatten(-1, {3, 3}); };
  Tensor const rotation = matrix({cy, sy * sx, x, zero, cx, y, sy, -cy * sx, z});
  if (return_inverse) return rotation.mT().matmul(matrix({1 / z, zero, x / z, zero, 1 / z, y / z, zero, zero, one}));
  return matrix({z, zero, -x, zero, z, -y, zero, zero, one}).matmul(rotation);
}

namespace detail {

// A lens in torch's operators, for what is to be differentiated.
struct Lens {
  Tensor source, target, dist;  // the camera matrices of the points and of the result
  std::optional<Tensor> tilt;

  static Tensor entry(Tensor const& m, int64_t i, int64_t k) { return m.select(1, i).narrow(1, k, 1); }
  std::pair<Tensor, Tensor> normalized(Tensor const& points) const {
    return {(points.select(2, 0) - entry(source, 0, 2)) / entry(source, 0, 0),
            (points.select(2, 1) - entry(source, 1, 2)) / entry(source, 1, 1)};
  }
  Tensor in_pixels(Tensor const& x, Tensor const& y) const {
    return at::stack({x * entry(target, 0, 0) + entry(target, 0, 2), y * entry(target, 1, 1) + entry(target, 1, 2)}, 2);
  }
  std::pair<Tensor, Tensor> tilted(Tensor const& x, Tensor const& y) const {
    if (!tilt) return {x, y};
    auto const row = [&](int64_t i) { return x * entry(*tilt, i, 0) + y * entry(*tilt, i, 1) + entry(*tilt, i, 2); };
    return {row(0) / row(2), row(1) / row(2)};
  }
  // The radial factor and the tangential shift of normalized points.
  std::tuple<Tensor, Tensor, Tensor> terms(Tensor const& x, Tensor const& y) const {
    Tensor const all = at::constant_pad_nd(dist, {0, 14 - dist.size(1)}), r2 = x * x + y * y;
    auto const c = [&](int64_t i) { return all.narrow(1, i, 1); };
    return {(1 + r2 * (c(0) + r2 * (c(1) + r2 * c(4)))) / (1 + r2 * (c(5) + r2 * (c(6) + r2 * c(7)))),
            2 * c(2) * x * y + c(3) * (r2 + 2 * x * x) + r2 * (c(8) + r2 * c(9)),
            c(2) * (r2 + 2 * y * y) + 2 * c(3) * x * y + r2 * (c(10) + r2 * c(11))};
  }
  bool is_variable() const {
    return at::GradMode::is_enabled() && (source.requires_grad() || target.requires_grad() || dist.requires_grad());
  }
};

inline std::optional<Tensor> tilt_of(Tensor const& dist, bool inverse) {
  return dist.size(-1) == 14 ? std::optional(tilt_projection(dist.select(1, 12), dist.select(1, 13), inverse))
                             : std::nullopt;
}

}  // namespace detail

// Pixels of an ideal camera `new_K`, or K, to where a lens shows them.
inline Tensor distort_points(Tensor const& points, Tensor const& K, Tensor const& dist,
                             std::optional<Tensor> const& new_K = {}) {
  detail::shaped("distort_points", "points", points, 3, "(B, N, 2)");
  detail::shaped("distort_points", "dist", dist, 2, "(B or 1, n)");
  detail::Lens const lens{new_K.value_or(K), K, dist, detail::tilt_of(dist, false)};
  if (!lens.is_variable() && !points.requires_grad())
    return ops::distort_points(points, lens.source, lens.target, dist, lens.tilt);
  auto const [x, y] = lens.normalized(points);
  auto const [factor, dx, dy] = lens.terms(x, y);
  auto const [u, v] = lens.tilted(x * factor + dx, y * factor + dy);
  return lens.in_pixels(u, v);
}

// Back from there; NaN, without a gradient, where the lens shows no point. The gradient is that of the implicit
// function.
inline Tensor undistort_points(Tensor const& points, Tensor const& K, Tensor const& dist,
                               std::optional<Tensor> const& new_K = {}, int64_t num_iters = 5) {
  detail::shaped("undistort_points", "points", points, 3, "(B, N, 2)");
  detail::shaped("undistort_points", "dist", dist, 2, "(B or 1, n)");
  detail::Lens const lens{K, new_K.value_or(K), dist, detail::tilt_of(dist, true)};
  if (!at::GradMode::is_enabled() || (!lens.is_variable() && !points.requires_grad()))
    return ops::undistort_points(points, lens.source, lens.target, dist, lens.tilt, num_iters);
  auto const [u, v] = lens.normalized(points);
  auto const [x0, y0] = lens.tilted(u, v);
  auto const constant = [](Tensor const& t) { return t.detach(); };
  std::optional<Tensor> const tilt = lens.tilt ? std::optional(constant(*lens.tilt)) : std::nullopt;
  Tensor const solution = ops::undistort_points(constant(points), constant(lens.source),
                                                at::eye(3, K.options()).unsqueeze(0), constant(dist), tilt, num_iters);
  Tensor const is_point = solution.isfinite().all(2), start = at::where(is_point.unsqueeze(2), solution, 0);
  // Newton steps x - J^-1 (lens(x) - x0) from the solution, with J of the solution: one has the first derivatives of
  // the implicit function, two the second ones.
  Tensor const at_x = constant(start.select(2, 0)).requires_grad_(),
               at_y = constant(start.select(2, 1)).requires_grad_();
  detail::Lens const fixed{constant(lens.source), constant(lens.target), constant(dist), tilt};
  auto const [f, sx, sy] = fixed.terms(at_x, at_y);
  auto const row = [&](Tensor const& value) { return torch::autograd::grad({value.sum()}, {at_x, at_y}, {}, true); };
  auto const in_x = row(at_x * f + sx), in_y = row(at_y * f + sy);
  Tensor const a = in_x[0], b = in_x[1], c = in_y[0], d = in_y[1], determinant = a * d - b * c;
  Tensor x = constant(at_x), y = constant(at_y);
  for (int step = 0; step < 2; ++step) {
    auto const [factor, dx, dy] = lens.terms(x, y);
    Tensor const off_x = x * factor + dx - x0, off_y = y * factor + dy - y0;
    x = x - (d * off_x - b * off_y) / determinant;
    y = y - (a * off_y - c * off_x) / determinant;
  }
  return at::where(is_point.unsqueeze(2), lens.in_pixels(x, y), std::numeric_limits<double>::quiet_NaN());
}

inline Tensor undistort_image(Tensor const& image, Tensor const& K, Tensor const& dist) {
  detail::images("undistort_image", "image", image);
  Tensor const coefficients = detail::computed(dist, image);
  Tensor const map = ops::undistort_map(detail::computed(K, image), coefficients, detail::tilt_of(coefficients, false),
                                        detail::image_size(image));
  return ops::remap(image, map.select(1, 0), map.select(1, 1), {}, {}, int64_t(Interpolation::bilinear),
                    detail::padding_number(PaddingMode::zeros), true, false, false);
}

// The poses [R | t], (B, 3, 4), of cameras that show points (B, N, 3) at pixels (B, N, 2), N of 6 and more.
inline Tensor solve_pnp_dlt(Tensor const& world_points, Tensor const& img_points, Tensor const& intrinsics,
                            std::optional<Tensor> const& weights = {}, double svd_eps = 1e-4) {
  detail::shaped("solve_pnp_dlt", "world_points", world_points, 3, "(B, N, 3)");
  return ops::pose_dlt(world_points, img_points, intrinsics, weights, svd_eps);
}

}  // namespace kvision
