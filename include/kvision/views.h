// Several views: points, homographies and models that relate images. Each function has the arguments of the operator
// torch.ops.kvision.<name>, which python/kvision/geometry explains. All are in float32 or float64, points
// (B, N, 2) as (x, y). Null vectors, homographies, fundamental matrices, poses, motions, points in space and those of
// lenses have gradients; consensus, contest and eigenvectors have none; those of minimal models and roots, and second
// derivatives, are errors.
#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "kvision/operator.h"

namespace kvision {

namespace detail {

// For what has no kernel for its gradient.
inline Gradient no_gradient(char const* op) {
  return [op](Backward const&) -> variable_list {
    TORCH_CHECK_NOT_IMPLEMENTED(false, op, ": C++ has no gradient of it; Python's kvision has");
  };
}

}  // namespace detail

// --- least squares ---------------------------------------------------------------------------------------------------

inline std::tuple<Tensor, Tensor> null_vector_backward(Tensor const& grad, Tensor const& vector, Tensor const& rows,
                                                       std::optional<Tensor> const& weights) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_rows, to_weights] = call<"null_vector_backward", std::tuple<Tensor, Tensor>>(grad, vector, rows, weights);
    return variable_list{to_rows, to_weights};
  };
  variable_list const found = differentiable({grad, vector, rows, weights.value_or(Tensor())}, compute, {},
                                             no_second_derivative("null_vector"));
  return {found[0], found[1]};
}

// The unit vectors v (B, n) with the least sum of weights * (rows v)^2, for rows (B, m, n) and weights (B, m); n is 3,
// 4, 9 or 12.
inline Tensor null_vector(Tensor const& rows, std::optional<Tensor> const& weights = {}) {
  using namespace detail;
  Tensor const given = weights.value_or(Tensor());
  Tensor const vector = [&] {
    at::AutoDispatchBelowADInplaceOrView below_autograd;
    return call<"null_vector">(rows, weights);
  }();
  auto const compute = [&] { return variable_list{vector}; };
  auto const gradient = [](Backward const& b) {
    Tensor const &v = b.saved[0], &r = b.saved[1], &w = b.saved[2];
    auto const [to_rows, to_weights] =
        null_vector_backward(b.grads[0], v, r, w.defined() ? std::optional(w) : std::nullopt);
    return variable_list{to_rows, w.defined() ? to_weights : Tensor()};
  };
  return differentiable({rows, given}, compute, {vector.detach(), rows, given}, gradient)[0];
}

namespace detail {

inline std::optional<Tensor> if_defined(Tensor const& x) { return x.defined() ? std::optional(x) : std::nullopt; }

// Of an operator of points in both images and weights.
template <Name name>
std::tuple<Tensor, Tensor, Tensor> dlt_backward(Tensor const& grad, Tensor const& points1, Tensor const& points2,
                                                std::optional<Tensor> const& weights, char const* op) {
  auto const compute = [&] {
    auto [to_points1, to_points2, to_weights] =
        call<name, std::tuple<Tensor, Tensor, Tensor>>(grad, points1, points2, weights);
    return variable_list{to_points1, to_points2, to_weights};
  };
  variable_list const tensors{grad, points1, points2, weights.value_or(Tensor())};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative(op));
  return {found[0], found[1], found[2]};
}

template <Name name, class Derivative>
Tensor dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights, Derivative backward) {
  Tensor const given = weights.value_or(Tensor());
  auto const compute = [&] { return variable_list{call<name>(points1, points2, weights)}; };
  auto const gradient = [backward](Backward const& b) {
    Tensor const& w = b.saved[2];
    auto const [to_points1, to_points2, to_weights] = backward(b.grads[0], b.saved[0], b.saved[1], if_defined(w));
    return variable_list{to_points1, to_points2, w.defined() ? to_weights : Tensor()};
  };
  return differentiable({points1, points2, given}, compute, {points1, points2, given}, gradient)[0];
}

}  // namespace detail

inline std::tuple<Tensor, Tensor, Tensor> homography_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                                  Tensor const& points2,
                                                                  std::optional<Tensor> const& weights) {
  return detail::dlt_backward<"homography_dlt_backward">(grad, points1, points2, weights, "homography_dlt");
}

// The homographies (B, 3, 3) that take points nearest to others, with weights (B, N), by direct linear transformation.
inline Tensor homography_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights = {}) {
  return detail::dlt<"homography_dlt">(points1, points2, weights, homography_dlt_backward);
}

inline std::tuple<Tensor, Tensor, Tensor> homography_lines_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                                        Tensor const& points2,
                                                                        std::optional<Tensor> const& weights) {
  return detail::dlt_backward<"homography_lines_dlt_backward">(grad, points1, points2, weights, "homography_lines_dlt");
}

// The homographies (B, 3, 3) that take the ends of segments (B, N, 2, 2) nearest to the lines of others, with weights
// (B, N).
inline Tensor homography_lines_dlt(Tensor const& points1, Tensor const& points2,
                                   std::optional<Tensor> const& weights = {}) {
  return detail::dlt<"homography_lines_dlt">(points1, points2, weights, homography_lines_dlt_backward);
}

inline std::tuple<Tensor, Tensor> normalize_points_backward(Tensor const& grad, Tensor const& grad_matrix,
                                                            Tensor const& points, std::optional<Tensor> const& weights,
                                                            double eps) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_points, to_weights] =
        call<"normalize_points_backward", std::tuple<Tensor, Tensor>>(grad, grad_matrix, points, weights, eps);
    return variable_list{to_points, to_weights};
  };
  variable_list const tensors{grad, grad_matrix, points, weights.value_or(Tensor())};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative("normalize_points"));
  return {found[0], found[1]};
}

// Points (B, N, 2) about 0 at a mean distance of sqrt(2), with weights (B, N) in both means, and the similarity (B, 3,
// 3) that takes the given ones there.
inline std::tuple<Tensor, Tensor> normalize_points(Tensor const& points, std::optional<Tensor> const& weights = {},
                                                   double eps = 1e-8) {
  using namespace detail;
  Tensor const given = weights.value_or(Tensor());
  auto const compute = [&] {
    auto [normalized, matrix] = call<"normalize_points", std::tuple<Tensor, Tensor>>(points, weights, eps);
    return variable_list{normalized, matrix};
  };
  auto const gradient = [eps](Backward const& b) {
    Tensor const &x = b.saved[0], &w = b.saved[1];
    Tensor const grad = b.grads[0].defined() ? b.grads[0] : at::zeros_like(x);
    Tensor const grad_matrix = b.grads[1].defined() ? b.grads[1] : at::zeros({x.size(0), 3, 3}, x.options());
    auto const [to_points, to_weights] = normalize_points_backward(grad, grad_matrix, x, if_defined(w), eps);
    return variable_list{to_points, w.defined() ? to_weights : Tensor()};
  };
  variable_list const found = differentiable({points, given}, compute, {points, given}, gradient);
  return {found[0], found[1]};
}

inline std::tuple<Tensor, Tensor, Tensor> fundamental_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                                   Tensor const& points2,
                                                                   std::optional<Tensor> const& weights) {
  return detail::dlt_backward<"fundamental_dlt_backward">(grad, points1, points2, weights, "fundamental_dlt");
}

// The fundamental matrices (B, 3, 3) of rank 2 that correspondences fit best, with weights (B, N), of eight and more.
inline Tensor fundamental_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights = {}) {
  return detail::dlt<"fundamental_dlt">(points1, points2, weights, fundamental_dlt_backward);
}

inline std::tuple<Tensor, Tensor, Tensor> affine_fit_backward(Tensor const& grad, Tensor const& points1,
                                                              Tensor const& points2,
                                                              std::optional<Tensor> const& weights) {
  return detail::dlt_backward<"affine_fit_backward">(grad, points1, points2, weights, "affine_fit");
}

// The affine maps (B, 3, 3) that take points nearest to others, with weights (B, N); NaN for points on a line.
inline Tensor affine_fit(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights = {}) {
  return detail::dlt<"affine_fit">(points1, points2, weights, affine_fit_backward);
}

inline std::tuple<Tensor, Tensor, Tensor, Tensor> pose_dlt_backward(Tensor const& grad, Tensor const& points,
                                                                    Tensor const& pixels, Tensor const& camera,
                                                                    std::optional<Tensor> const& weights, double flat) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_points, to_pixels, to_camera, to_weights] =
        call<"pose_dlt_backward", std::tuple<Tensor, Tensor, Tensor, Tensor>>(grad, points, pixels, camera, weights,
                                                                              flat);
    return variable_list{to_points, to_pixels, to_camera, to_weights};
  };
  variable_list const tensors{grad, points, pixels, camera, weights.value_or(Tensor())};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative("pose_dlt"));
  return {found[0], found[1], found[2], found[3]};
}

// The poses [R | t], (B, 3, 4), of cameras (B, 3, 3) that show points in space (B, N, 3) at pixels (B, N, 2), with
// weights (B, N) of the errors; NaN for points in a plane, whose least extent is below `flat`.
inline Tensor pose_dlt(Tensor const& points, Tensor const& pixels, Tensor const& camera,
                       std::optional<Tensor> const& weights = {}, double flat = 1e-4) {
  using namespace detail;
  Tensor const given = weights.value_or(Tensor());
  auto const compute = [&] { return variable_list{call<"pose_dlt">(points, pixels, camera, weights, flat)}; };
  auto const gradient = [flat](Backward const& b) {
    Tensor const& w = b.saved[3];
    auto const [to_points, to_pixels, to_camera, to_weights] =
        pose_dlt_backward(b.grads[0], b.saved[0], b.saved[1], b.saved[2], if_defined(w), flat);
    return variable_list{to_points, to_pixels, to_camera, w.defined() ? to_weights : Tensor()};
  };
  return differentiable({points, pixels, camera, given}, compute, {points, pixels, camera, given}, gradient)[0];
}

inline std::tuple<Tensor, Tensor, Tensor, Tensor> triangulate_backward(Tensor const& grad, Tensor const& points1,
                                                                       Tensor const& points2,
                                                                       Tensor const& projections1,
                                                                       Tensor const& projections2) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_points1, to_points2, to_projections1, to_projections2] =
        call<"triangulate_backward", std::tuple<Tensor, Tensor, Tensor, Tensor>>(grad, points1, points2, projections1,
                                                                                 projections2);
    return variable_list{to_points1, to_points2, to_projections1, to_projections2};
  };
  variable_list const tensors{grad, points1, points2, projections1, projections2};
  variable_list const found = differentiable(tensors, compute, {}, no_second_derivative("triangulate"));
  return {found[0], found[1], found[2], found[3]};
}

// Points in space (B, N, 3) from their pictures in two images of projections (B, 3, 4); NaN for points at infinity.
inline Tensor triangulate(Tensor const& points1, Tensor const& points2, Tensor const& projections1,
                          Tensor const& projections2) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"triangulate">(points1, points2, projections1, projections2)}; };
  auto const gradient = [](Backward const& b) {
    auto const [to_points1, to_points2, to_projections1, to_projections2] =
        triangulate_backward(b.grads[0], b.saved[0], b.saved[1], b.saved[2], b.saved[3]);
    return variable_list{to_points1, to_points2, to_projections1, to_projections2};
  };
  variable_list const tensors{points1, points2, projections1, projections2};
  return differentiable(tensors, compute, tensors, gradient)[0];
}

namespace detail {

// A lens in torch's operators, for what is to be differentiated: its camera matrix, coefficients (B, 4 to 14).
struct Lens {
  Tensor camera, wanted, coefficients;
  std::optional<Tensor> tilt;

  static Tensor entry(Tensor const& m, int64_t i, int64_t k) { return m.select(1, i).narrow(1, k, 1); }
  std::pair<Tensor, Tensor> on_plane(Tensor const& points) const {
    return {(points.select(2, 0) - entry(camera, 0, 2)) / entry(camera, 0, 0),
            (points.select(2, 1) - entry(camera, 1, 2)) / entry(camera, 1, 1)};
  }
  Tensor in_pixels(Tensor const& x, Tensor const& y) const {
    return at::stack({x * entry(wanted, 0, 0) + entry(wanted, 0, 2), y * entry(wanted, 1, 1) + entry(wanted, 1, 2)}, 2);
  }
  std::pair<Tensor, Tensor> turned(Tensor const& x, Tensor const& y) const {
    if (!tilt) return {x, y};
    auto const row = [&](int64_t i) { return x * entry(*tilt, i, 0) + y * entry(*tilt, i, 1) + entry(*tilt, i, 2); };
    return {row(0) / row(2), row(1) / row(2)};
  }
  // The factor and the shift of points on the plane.
  std::tuple<Tensor, Tensor, Tensor> terms(Tensor const& x, Tensor const& y) const {
    Tensor const all = at::constant_pad_nd(coefficients, {0, 14 - coefficients.size(1)}), r2 = x * x + y * y;
    auto const c = [&](int64_t i) { return all.narrow(1, i, 1); };
    return {(1 + r2 * (c(0) + r2 * (c(1) + r2 * c(4)))) / (1 + r2 * (c(5) + r2 * (c(6) + r2 * c(7)))),
            2 * c(2) * x * y + c(3) * (r2 + 2 * x * x) + r2 * (c(8) + r2 * c(9)),
            c(2) * (r2 + 2 * y * y) + 2 * c(3) * x * y + r2 * (c(10) + r2 * c(11))};
  }
};

}  // namespace detail

// Points to where a lens shows them. For each problem, or for all: the camera matrix of the points and the one `wanted`
// (3, 3); the first of k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4; and the matrix to the plane of a tilted sensor.
// What is to be differentiated is made of torch's operators.
inline Tensor distort(Tensor const& points, Tensor const& camera, Tensor const& wanted, Tensor const& coefficients,
                      std::optional<Tensor> const& tilt = {}) {
  using namespace detail;
  if (!wants_gradient({points, camera, wanted, coefficients, tilt.value_or(Tensor())})) {
    auto const compute = [&] { return variable_list{call<"distort">(points, camera, wanted, coefficients, tilt)}; };
    return differentiable({}, compute, {}, nullptr)[0];
  }
  Lens const lens{camera, wanted, coefficients, tilt};
  auto const [x, y] = lens.on_plane(points);
  auto const [factor, dx, dy] = lens.terms(x, y);
  auto const [u, v] = lens.turned(x * factor + dx, y * factor + dy);
  return lens.in_pixels(u, v);
}

// The gradients of `lens_map` to camera, coefficients and tilt of each sample.
inline variable_list lens_map_backward(Tensor const& grad, Tensor const& camera, Tensor const& coefficients,
                                       std::optional<Tensor> const& tilt) {
  using namespace detail;
  auto const compute = [&] {
    auto const [a, b, c] =
        call<"lens_map_backward", std::tuple<Tensor, Tensor, Tensor>>(grad, camera, coefficients, tilt);
    return variable_list{a, b, c};
  };
  return differentiable({grad, camera, coefficients, tilt.value_or(Tensor())}, compute, {},
                        no_second_derivative("lens_map"));
}

// Where a lens shows the pixels of an image of that size: x and y, (B, 2, H, W). Its camera matrix is that of both.
inline Tensor lens_map(Tensor const& camera, Tensor const& coefficients, std::optional<Tensor> const& tilt,
                       std::vector<int64_t> const& size) {
  using namespace detail;
  Tensor const turned = tilt.value_or(Tensor());
  auto const compute = [&] { return variable_list{call<"lens_map">(camera, coefficients, tilt, size)}; };
  auto const gradient = [](Backward const& b) {
    Tensor const& tilt = b.saved[2];
    variable_list found =
        lens_map_backward(b.grads[0], b.saved[0], b.saved[1], tilt.defined() ? std::optional(tilt) : std::nullopt);
    for (size_t i = 0; i < 3; ++i) found[i] = b.wanted(i) ? at::sum_to(found[i], b.saved[i].sizes()) : Tensor();
    return found;
  };
  return differentiable({camera, coefficients, turned}, compute, {camera, coefficients, turned}, gradient)[0];
}

// Back from there, by `steps` of a fixed-point iteration; the matrix takes the plane of a tilted sensor back.
inline Tensor undistort(Tensor const& points, Tensor const& camera, Tensor const& wanted, Tensor const& coefficients,
                        std::optional<Tensor> const& tilt = {}, int64_t steps = 5) {
  using namespace detail;
  if (!wants_gradient({points, camera, wanted, coefficients, tilt.value_or(Tensor())})) {
    auto const compute = [&] {
      return variable_list{call<"undistort">(points, camera, wanted, coefficients, tilt, steps)};
    };
    return differentiable({}, compute, {}, nullptr)[0];
  }
  Lens const lens{camera, wanted, coefficients, tilt};
  auto const [x0, y0] = [&] {
    auto const [x, y] = lens.on_plane(points);
    return lens.turned(x, y);
  }();
  Tensor x = x0, y = y0;
  for (int64_t step = 0; step < steps; ++step) {
    auto const [factor, dx, dy] = lens.terms(x, y);
    x = (x0 - dx) / factor;
    y = (y0 - dy) / factor;
  }
  return lens.in_pixels(x, y);
}

// Eigenvalues (B, n), ascending, of symmetric matrices (B, n, n), and their vectors as columns. No gradient.
inline std::tuple<Tensor, Tensor> eigenvectors(Tensor const& matrix) {
  using namespace detail;
  auto const compute = [&] {
    auto [values, vectors] = call<"eigenvectors", std::tuple<Tensor, Tensor>>(matrix);
    return variable_list{values, vectors};
  };
  variable_list const found = differentiable({}, compute, {}, nullptr);
  return {found[0], found[1]};
}

// --- essential matrices ----------------------------------------------------------------------------------------------

inline Tensor nearest_essential_backward(Tensor const& grad, Tensor const& matrix) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"nearest_essential_backward">(grad, matrix)}; };
  return differentiable({grad, matrix}, compute, {}, no_second_derivative("nearest_essential"))[0];
}

// The nearest essential matrices, of two equal singular values and 0, of matrices (B, 3, 3).
inline Tensor nearest_essential(Tensor const& matrix) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"nearest_essential">(matrix)}; };
  auto const gradient = [](Backward const& b) {
    return variable_list{nearest_essential_backward(b.grads[0], b.saved[0])};
  };
  return differentiable({matrix}, compute, {matrix}, gradient)[0];
}

inline Tensor essential_motions_backward(Tensor const& grad, Tensor const& grad_directions, Tensor const& matrix) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"essential_motions_backward">(grad, grad_directions, matrix)}; };
  return differentiable({grad, grad_directions, matrix}, compute, {}, no_second_derivative("essential_motions"))[0];
}

// The four motions of essential matrices (B, 3, 3): rotations (B, 4, 3, 3), directions of translations (B, 4, 3, 1).
inline std::tuple<Tensor, Tensor> essential_motions(Tensor const& matrix) {
  using namespace detail;
  auto const compute = [&] {
    auto [rotations, directions] = call<"essential_motions", std::tuple<Tensor, Tensor>>(matrix);
    return variable_list{rotations, directions};
  };
  auto const gradient = [](Backward const& b) {
    Tensor const& e = b.saved[0];
    Tensor const to_rotations = b.grads[0].defined() ? b.grads[0] : at::zeros({e.size(0), 4, 3, 3}, e.options());
    Tensor const to_directions = b.grads[1].defined() ? b.grads[1] : at::zeros({e.size(0), 4, 3, 1}, e.options());
    return variable_list{essential_motions_backward(to_rotations, to_directions, e)};
  };
  variable_list const found = differentiable({matrix}, compute, {matrix}, gradient);
  return {found[0], found[1]};
}

// The one of these motions that leaves most points in front of both cameras (B, 3, 3), by their pixels (B, N, 2) and a
// mask (B, N), or none, of those that count: rotation, direction, points in space (B, N, 3), how many are in front (B),
// and which of the four it is (B).
inline std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor> motion_choice(Tensor const& matrix, Tensor const& camera1,
                                                                        Tensor const& camera2, Tensor const& points1,
                                                                        Tensor const& points2,
                                                                        std::optional<Tensor> const& mask = {}) {
  using namespace detail;
  auto const compute = [&] {
    auto [rotation, direction, space, in_front, which] =
        call<"motion_choice", std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor>>(matrix, camera1, camera2, points1,
                                                                                  points2, mask);
    return variable_list{rotation, direction, space, in_front, which};
  };
  variable_list const found =
      differentiable({matrix, camera1, camera2, points1, points2}, compute, {}, no_gradient("motion_choice"));
  return {found[0], found[1], found[2], found[3], found[4]};
}

// --- errors ----------------------------------------------------------------------------------------------------------

inline std::tuple<Tensor, Tensor, Tensor> view_errors_backward(Tensor const& grad, Tensor const& points1,
                                                               Tensor const& points2, Tensor const& matrix,
                                                               std::string const& kind, bool squared) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_points1, to_points2, to_matrix] =
        call<"view_errors_backward", std::tuple<Tensor, Tensor, Tensor>>(grad, points1, points2, matrix, kind, squared);
    return variable_list{to_points1, to_points2, to_matrix};
  };
  variable_list const found =
      differentiable({grad, points1, points2, matrix}, compute, {}, no_second_derivative("view_errors"));
  return {found[0], found[1], found[2]};
}

// How far correspondences (B, N, 2 or 3) are from matrices (B, 3, 3), (B, N); one of each serves a batch. kind:
// "sampson", "symmetrical", "right", "left" of fundamental matrices, the last two of which are distances whatever
// `squared` says; "transfer", "symmetric_transfer", "sampson_transfer" and "segments" of homographies, the
// last of points (B, N, 4).
inline Tensor view_errors(Tensor const& points1, Tensor const& points2, Tensor const& matrix, std::string const& kind,
                          bool squared) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"view_errors">(points1, points2, matrix, kind, squared)}; };
  auto const gradient = [=](Backward const& b) {
    auto const [to_points1, to_points2, to_matrix] =
        view_errors_backward(b.grads[0], b.saved[0], b.saved[1], b.saved[2], kind, squared);
    return variable_list{to_points1.sum_to_size(b.saved[0].sizes()), to_points2.sum_to_size(b.saved[1].sizes()),
                         to_matrix.sum_to_size(b.saved[2].sizes())};
  };
  return differentiable({points1, points2, matrix}, compute, {points1, points2, matrix}, gradient)[0];
}

// --- samples and those who agree with them ---------------------------------------------------------------------------

// Models (S, candidates, 3, 3) that as few correspondences as possible leave, NaN for what is missing. model: "affine",
// "homography", "lines" of points (., ., 4), "fundamental", "fundamental8" or "essential". Samples are the points (S,
// m, 2), or with `draws` (S, m + 1) chosen from points (1, N, 2): m numbers in [0, 1), and from how many of the first.
inline Tensor minimal(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& draws,
                      std::string const& model) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"minimal">(points1, points2, draws, model)}; };
  return differentiable({points1, points2}, compute, {}, no_gradient("minimal"))[0];
}

// (M, 2) of models (M, 3, 3): the sum of 1 - e / threshold^2 over the correspondences, points (2 or 4, N), whose
// squared error e is at most threshold^2, and their number. No gradient.
inline Tensor consensus(Tensor const& models, Tensor const& points1, Tensor const& points2, double threshold,
                        std::string const& model) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"consensus">(models, points1, points2, threshold, model)}; };
  return differentiable({}, compute, {}, nullptr)[0];
}

// The best `count` of models (M, 3, 3) by their consensus (M, 2), by the number of who agrees or by the sum, with that
// consensus. No gradient.
inline std::tuple<Tensor, Tensor> leaders(Tensor const& models, Tensor const& scores, int64_t count, bool by_number) {
  using namespace detail;
  auto const compute = [&] {
    auto [best, best_scores] = call<"leaders", std::tuple<Tensor, Tensor>>(models, scores, count, by_number);
    return variable_list{best, best_scores};
  };
  variable_list const found = differentiable({}, compute, {}, nullptr);
  return {found[0], found[1]};
}

// The first of models (M, 3, 3), and which of N correspondences weigh more than 0 for it, by weights (M, N); zeros and
// nobody where these are no more than `least`. Of norm 1 for "essential", others with a last number of 1. No gradient.
inline std::tuple<Tensor, Tensor> verdict(Tensor const& models, Tensor const& weights, int64_t least,
                                          std::string const& model) {
  using namespace detail;
  auto const compute = [&] {
    auto [found, fits] = call<"verdict", std::tuple<Tensor, Tensor>>(models, weights, least, model);
    return variable_list{found, fits};
  };
  variable_list const found = differentiable({}, compute, {}, nullptr);
  return {found[0], found[1]};
}

// The best `count` of two lists of models (M, 3, 3) by their consensus (M, 2): by the number of who agrees, or by the
// sum. With that consensus, and what correspondences weigh: 1 / (1 + softness e) of those who agree, 0 of others. No
// gradient.
inline std::tuple<Tensor, Tensor, Tensor> contest(Tensor const& models, Tensor const& scores, Tensor const& others,
                                                  Tensor const& other_scores, Tensor const& points1,
                                                  Tensor const& points2, double threshold, double softness,
                                                  int64_t count, bool by_number, std::string const& model) {
  using namespace detail;
  auto const compute = [&] {
    auto [best, best_scores, weights] = call<"contest", std::tuple<Tensor, Tensor, Tensor>>(
        models, scores, others, other_scores, points1, points2, threshold, softness, count, by_number, model);
    return variable_list{best, best_scores, weights};
  };
  variable_list const found = differentiable({}, compute, {}, nullptr);
  return {found[0], found[1], found[2]};
}

// Real roots (B, n) of polynomials (B, n + 1), the highest power first, ascending; NaN for those that are missing.
inline Tensor real_roots(Tensor const& coefficients) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"real_roots">(coefficients)}; };
  return differentiable({coefficients}, compute, {}, no_gradient("real_roots"))[0];
}

}  // namespace kvision
