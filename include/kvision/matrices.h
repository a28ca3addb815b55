// Rotations in all their forms, matrices of transforms of images and of two views, of every sample in one launch. Each
// function has the arguments of the operator torch.ops.kvision.<name>, which csrc/geometry/formulas.h has the formula
// of. Tensors may have one row for all; they are of one floating-point type, which the result has, too. All have
// gradients, which come as one tensor (B, n) of those of all tensors that are given, one after another; second
// derivatives are errors.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include <optional>
#include <string>
#include <tuple>
#include <utility>

#include "kvision/operator.h"

namespace kvision {

namespace detail {

template <size_t N>
consteval Name<N + 9> backward_of(Name<N> const& name) {
  char text[N + 9] = {};
  std::copy_n(name.text, N - 1, text);
  std::copy_n("_backward", 10, text + N - 1);
  return Name<N + 9>(text);
}

inline Tensor defined_or_none(Tensor const& x) { return x; }
inline Tensor defined_or_none(std::optional<Tensor> const& x) { return x.value_or(Tensor()); }

// What was saved of tensors, as the operator takes it.
inline void restore(Tensor& x, Tensor const& saved) { x = saved; }
inline void restore(std::optional<Tensor>& x, Tensor const& saved) {
  x = saved.defined() ? std::optional(saved) : std::nullopt;
}

template <class... Tensors>
variable_list as_list(std::tuple<Tensors...> const& tensors) {
  return std::apply([](auto const&... x) { return variable_list{defined_or_none(x)...}; }, tensors);
}

template <Name name, class... Tensors, class... Plain>
Tensor formula_gradient(Tensor const& grad, std::tuple<Tensors...> const& tensors, Plain const&... plain) {
  auto const compute = [&] {
    return std::apply([&](auto const&... x) { return variable_list{call<backward_of(name)>(grad, x..., plain...)}; },
                      tensors);
  };
  variable_list all = as_list(tensors);
  all.insert(all.begin(), grad);
  return differentiable(all, compute, {}, no_second_derivative(name.text))[0];
}

template <Name name, class... Tensors, class... Plain>
Tensor formula(std::tuple<Tensors...> const& tensors, Plain const&... plain) {
  auto const compute = [&] {
    return std::apply([&](auto const&... x) { return variable_list{call<name>(x..., plain...)}; }, tensors);
  };
  auto const gradient = [=](Backward const& b) {
    std::tuple<Tensors...> given;
    size_t next = 0;
    std::apply([&](auto&... x) { (restore(x, b.saved[next++]), ...); }, given);
    Tensor const slopes = formula_gradient<name>(b.grads[0], given, plain...);
    variable_list found(b.saved.size());
    int64_t column = 0;
    for (size_t i = 0; i < found.size(); ++i) {
      Tensor const& x = b.saved[i];
      if (!x.defined()) continue;
      std::vector<int64_t> shape = x.sizes().vec();
      shape[0] = 1;
      int64_t const width = c10::multiply_integers(shape);
      shape[0] = slopes.size(0);
      if (b.wanted(i)) found[i] = at::sum_to(slopes.narrow(1, column, width).reshape(shape), x.sizes());
      column += width;
    }
    return found;
  };
  variable_list const all = as_list(tensors);
  return differentiable(all, compute, all, gradient)[0];
}

}  // namespace detail

// --- rotations -------------------------------------------------------------------------------------------------------

inline Tensor axis_angle_to_rotation_matrix_backward(Tensor const& grad, Tensor const& axis_angle) {
  return detail::formula_gradient<"axis_angle_to_rotation_matrix">(grad, std::tuple(axis_angle));
}
// (B, 3) to (B, 3, 3).
inline Tensor axis_angle_to_rotation_matrix(Tensor const& axis_angle) {
  return detail::formula<"axis_angle_to_rotation_matrix">(std::tuple(axis_angle));
}

inline Tensor quaternion_exponential_backward(Tensor const& grad, Tensor const& vector, double part) {
  return detail::formula_gradient<"quaternion_exponential">(grad, std::tuple(vector), part);
}
// The quaternion (B, 4) that turns by twice `part` times the length of a vector (B, 3): axes times angles have 0.5.
inline Tensor quaternion_exponential(Tensor const& vector, double part) {
  return detail::formula<"quaternion_exponential">(std::tuple(vector), part);
}

inline Tensor quaternion_to_axis_angle_backward(Tensor const& grad, Tensor const& quaternion) {
  return detail::formula_gradient<"quaternion_to_axis_angle">(grad, std::tuple(quaternion));
}
// (B, 4) as (w, x, y, z), of any length, to (B, 3) at most pi long.
inline Tensor quaternion_to_axis_angle(Tensor const& quaternion) {
  return detail::formula<"quaternion_to_axis_angle">(std::tuple(quaternion));
}

inline Tensor quaternion_logarithm_backward(Tensor const& grad, Tensor const& quaternion) {
  return detail::formula_gradient<"quaternion_logarithm">(grad, std::tuple(quaternion));
}
// (B, 4) to (B, 3), half as long as the angle.
inline Tensor quaternion_logarithm(Tensor const& quaternion) {
  return detail::formula<"quaternion_logarithm">(std::tuple(quaternion));
}

inline Tensor quaternion_product_backward(Tensor const& grad, Tensor const& left, Tensor const& right) {
  return detail::formula_gradient<"quaternion_product">(grad, std::tuple(left, right));
}
// Hamilton's product of (B, 4) as (w, x, y, z).
inline Tensor quaternion_product(Tensor const& left, Tensor const& right) {
  return detail::formula<"quaternion_product">(std::tuple(left, right));
}

inline Tensor normalize_quaternion_backward(Tensor const& grad, Tensor const& quaternion, double eps) {
  return detail::formula_gradient<"normalize_quaternion">(grad, std::tuple(quaternion), eps);
}
// (B, 4) divided by its length, or by `eps` where that is larger.
inline Tensor normalize_quaternion(Tensor const& quaternion, double eps) {
  return detail::formula<"normalize_quaternion">(std::tuple(quaternion), eps);
}

inline Tensor quaternion_to_rotation_matrix_backward(Tensor const& grad, Tensor const& quaternion) {
  return detail::formula_gradient<"quaternion_to_rotation_matrix">(grad, std::tuple(quaternion));
}
// (B, 4) of any length to (B, 3, 3).
inline Tensor quaternion_to_rotation_matrix(Tensor const& quaternion) {
  return detail::formula<"quaternion_to_rotation_matrix">(std::tuple(quaternion));
}

inline Tensor rotation_matrix_to_quaternion_backward(Tensor const& grad, Tensor const& matrix) {
  return detail::formula_gradient<"rotation_matrix_to_quaternion">(grad, std::tuple(matrix));
}
// (B, 3, 3) to (B, 4) of length 1.
inline Tensor rotation_matrix_to_quaternion(Tensor const& matrix) {
  return detail::formula<"rotation_matrix_to_quaternion">(std::tuple(matrix));
}

inline Tensor cross_matrix_backward(Tensor const& grad, Tensor const& vector) {
  return detail::formula_gradient<"cross_matrix">(grad, std::tuple(vector));
}
// [v] (B, 3, 3) with [v] x = v cross x, of (B, 3).
inline Tensor cross_matrix(Tensor const& vector) { return detail::formula<"cross_matrix">(std::tuple(vector)); }

inline Tensor compose_poses_backward(Tensor const& grad, Tensor const& first, Tensor const& second) {
  return detail::formula_gradient<"compose_poses">(grad, std::tuple(first, second));
}
// First the second, then the first pose (B, 4, 4).
inline Tensor compose_poses(Tensor const& first, Tensor const& second) {
  return detail::formula<"compose_poses">(std::tuple(first, second));
}

inline Tensor invert_pose_backward(Tensor const& grad, Tensor const& pose) {
  return detail::formula_gradient<"invert_pose">(grad, std::tuple(pose));
}
// R^T, -R^T t of (B, 4, 4).
inline Tensor invert_pose(Tensor const& pose) { return detail::formula<"invert_pose">(std::tuple(pose)); }

inline Tensor relative_pose_backward(Tensor const& grad, Tensor const& first, Tensor const& second) {
  return detail::formula_gradient<"relative_pose">(grad, std::tuple(first, second));
}
// The inverse of the first pose (B, 4, 4) times the second.
inline Tensor relative_pose(Tensor const& first, Tensor const& second) {
  return detail::formula<"relative_pose">(std::tuple(first, second));
}

inline Tensor rotation_matrix_to_axis_angle_backward(Tensor const& grad, Tensor const& matrix) {
  return detail::formula_gradient<"rotation_matrix_to_axis_angle">(grad, std::tuple(matrix));
}
// (B, 3, 3) to (B, 3).
inline Tensor rotation_matrix_to_axis_angle(Tensor const& matrix) {
  return detail::formula<"rotation_matrix_to_axis_angle">(std::tuple(matrix));
}

inline Tensor angle_to_rotation_matrix_backward(Tensor const& grad, Tensor const& degrees) {
  return detail::formula_gradient<"angle_to_rotation_matrix">(grad, std::tuple(degrees));
}
// (B,) to (B, 2, 2), [[cos, sin], [-sin, cos]]; quarter turns are exact.
inline Tensor angle_to_rotation_matrix(Tensor const& degrees) {
  return detail::formula<"angle_to_rotation_matrix">(std::tuple(degrees));
}

inline Tensor quaternion_from_euler_backward(Tensor const& grad, Tensor const& roll, Tensor const& pitch,
                                             Tensor const& yaw) {
  return detail::formula_gradient<"quaternion_from_euler">(grad, std::tuple(roll, pitch, yaw));
}
// Turns (B,) about the fixed axes x, y and z, in radians, to (B, 4).
inline Tensor quaternion_from_euler(Tensor const& roll, Tensor const& pitch, Tensor const& yaw) {
  return detail::formula<"quaternion_from_euler">(std::tuple(roll, pitch, yaw));
}

inline Tensor euler_from_quaternion_backward(Tensor const& grad, Tensor const& w, Tensor const& x, Tensor const& y,
                                             Tensor const& z) {
  return detail::formula_gradient<"euler_from_quaternion">(grad, std::tuple(w, x, y, z));
}
// Entries (B,) of quaternions to (B, 3): turns about x, y and z.
inline Tensor euler_from_quaternion(Tensor const& w, Tensor const& x, Tensor const& y, Tensor const& z) {
  return detail::formula<"euler_from_quaternion">(std::tuple(w, x, y, z));
}

// --- matrices of images ----------------------------------------------------------------------------------------------

inline Tensor affine_matrix2d_backward(Tensor const& grad, Tensor const& degrees,
                                       std::optional<Tensor> const& translation, std::optional<Tensor> const& scale,
                                       std::optional<Tensor> const& shear_x, std::optional<Tensor> const& shear_y,
                                       std::optional<Tensor> const& center, double turn, double x, double y,
                                       int64_t rows) {
  return detail::formula_gradient<"affine_matrix2d">(
      grad, std::tuple(degrees, translation, scale, shear_x, shear_y, center), turn, x, y, rows);
}
// Shear by angles (B,) in radians, scale (B, 2), turn by `turn` times degrees (B,), about a center (B, 2) or (x, y),
// then move by (B, 2): the first `rows` of (B, 3, 3).
inline Tensor affine_matrix2d(Tensor const& degrees, std::optional<Tensor> const& translation,
                              std::optional<Tensor> const& scale, std::optional<Tensor> const& shear_x,
                              std::optional<Tensor> const& shear_y, std::optional<Tensor> const& center, double turn,
                              double x, double y, int64_t rows) {
  return detail::formula<"affine_matrix2d">(std::tuple(degrees, translation, scale, shear_x, shear_y, center), turn, x,
                                            y, rows);
}

inline Tensor translation_matrix2d_backward(Tensor const& grad, Tensor const& translation, double x, double y,
                                            int64_t rows) {
  return detail::formula_gradient<"translation_matrix2d">(grad, std::tuple(translation), x, y, rows);
}
// (B, 2), and (x, y) more, to the first `rows` of (B, 3, 3).
inline Tensor translation_matrix2d(Tensor const& translation, double x, double y, int64_t rows) {
  return detail::formula<"translation_matrix2d">(std::tuple(translation), x, y, rows);
}

inline Tensor translation_matrix3d_backward(Tensor const& grad, Tensor const& translation, double x, double y, double z,
                                            int64_t rows) {
  return detail::formula_gradient<"translation_matrix3d">(grad, std::tuple(translation), x, y, z, rows);
}
// (B, 3), and (x, y, z) more, to the first `rows` of (B, 4, 4).
inline Tensor translation_matrix3d(Tensor const& translation, double x, double y, double z, int64_t rows) {
  return detail::formula<"translation_matrix3d">(std::tuple(translation), x, y, z, rows);
}

inline Tensor scale_matrix2d_backward(Tensor const& grad, Tensor const& scale, std::optional<Tensor> const& center,
                                      double x, double y) {
  return detail::formula_gradient<"scale_matrix2d">(grad, std::tuple(scale, center), x, y);
}
// Scales (B, 2) about a center (B, 2), or (x, y), to (B, 2, 3).
inline Tensor scale_matrix2d(Tensor const& scale, std::optional<Tensor> const& center, double x, double y) {
  return detail::formula<"scale_matrix2d">(std::tuple(scale, center), x, y);
}

inline Tensor shear_matrix2d_backward(Tensor const& grad, Tensor const& center, std::optional<Tensor> const& shear_x,
                                      std::optional<Tensor> const& shear_y) {
  return detail::formula_gradient<"shear_matrix2d">(grad, std::tuple(center, shear_x, shear_y));
}
// Shears by angles (B,) along x, then y, about a center (B, 2), to (B, 3, 3).
inline Tensor shear_matrix2d(Tensor const& center, std::optional<Tensor> const& shear_x,
                             std::optional<Tensor> const& shear_y) {
  return detail::formula<"shear_matrix2d">(std::tuple(center, shear_x, shear_y));
}

inline Tensor slant_matrix2d_backward(Tensor const& grad, Tensor const& slant) {
  return detail::formula_gradient<"slant_matrix2d">(grad, std::tuple(slant));
}
// x + slant_x y, y + slant_y x of (B, 2), to (B, 2, 3).
inline Tensor slant_matrix2d(Tensor const& slant) { return detail::formula<"slant_matrix2d">(std::tuple(slant)); }

inline Tensor invert_affine2d_backward(Tensor const& grad, Tensor const& matrix) {
  return detail::formula_gradient<"invert_affine2d">(grad, std::tuple(matrix));
}
// The inverse of (B, 2, 3).
inline Tensor invert_affine2d(Tensor const& matrix) { return detail::formula<"invert_affine2d">(std::tuple(matrix)); }

inline Tensor affine_matrix3d_backward(Tensor const& grad, Tensor const& x, Tensor const& y, Tensor const& z,
                                       std::optional<Tensor> const& translation, std::optional<Tensor> const& scale,
                                       std::optional<Tensor> const& center, std::optional<Tensor> const& xy,
                                       std::optional<Tensor> const& xz, std::optional<Tensor> const& yx,
                                       std::optional<Tensor> const& yz, std::optional<Tensor> const& zx,
                                       std::optional<Tensor> const& zy, double turn, double center_x, double center_y,
                                       double center_z, int64_t rows) {
  return detail::formula_gradient<"affine_matrix3d">(
      grad, std::tuple(x, y, z, translation, scale, center, xy, xz, yx, yz, zx, zy), turn, center_x, center_y, center_z,
      rows);
}
// Shear by angles (B,), scale (B, 3), turn by `turn` times the axis (x, y, z), as long as the angle in degrees, about a
// center (B, 3) or (center_x, center_y, center_z), then move by (B, 3): the first `rows` of (B, 4, 4).
inline Tensor affine_matrix3d(Tensor const& x, Tensor const& y, Tensor const& z,
                              std::optional<Tensor> const& translation, std::optional<Tensor> const& scale,
                              std::optional<Tensor> const& center, std::optional<Tensor> const& xy,
                              std::optional<Tensor> const& xz, std::optional<Tensor> const& yx,
                              std::optional<Tensor> const& yz, std::optional<Tensor> const& zx,
                              std::optional<Tensor> const& zy, double turn, double center_x, double center_y,
                              double center_z, int64_t rows) {
  return detail::formula<"affine_matrix3d">(std::tuple(x, y, z, translation, scale, center, xy, xz, yx, yz, zx, zy),
                                            turn, center_x, center_y, center_z, rows);
}

inline Tensor shear_matrix3d_backward(Tensor const& grad, Tensor const& center, std::optional<Tensor> const& xy,
                                      std::optional<Tensor> const& xz, std::optional<Tensor> const& yx,
                                      std::optional<Tensor> const& yz, std::optional<Tensor> const& zx,
                                      std::optional<Tensor> const& zy) {
  return detail::formula_gradient<"shear_matrix3d">(grad, std::tuple(center, xy, xz, yx, yz, zx, zy));
}
// Shears by angles (B,) along z, y and x, about a center (B, 3), to (B, 4, 4).
inline Tensor shear_matrix3d(Tensor const& center, std::optional<Tensor> const& xy, std::optional<Tensor> const& xz,
                             std::optional<Tensor> const& yx, std::optional<Tensor> const& yz,
                             std::optional<Tensor> const& zx, std::optional<Tensor> const& zy) {
  return detail::formula<"shear_matrix3d">(std::tuple(center, xy, xz, yx, yz, zx, zy));
}

inline Tensor perspective_matrix_backward(Tensor const& grad, Tensor const& points_src, Tensor const& points_dst) {
  return detail::formula_gradient<"perspective_matrix">(grad, std::tuple(points_src, points_dst));
}
// The homographies (B, 3, 3) that take four points (B, 4, 2) to others.
inline Tensor perspective_matrix(Tensor const& points_src, Tensor const& points_dst) {
  return detail::formula<"perspective_matrix">(std::tuple(points_src, points_dst));
}

inline Tensor perspective_matrix3d_backward(Tensor const& grad, Tensor const& points_src,
                                            std::optional<Tensor> const& points_dst, double x, double y, double z) {
  return detail::formula_gradient<"perspective_matrix3d">(grad, std::tuple(points_src, points_dst), x, y, z);
}
// The homographies (B, 4, 4) that take corners (B, 8, 3) of boxes to others, or to those of the box from 0 to (x, y,
// z).
inline Tensor perspective_matrix3d(Tensor const& points_src, std::optional<Tensor> const& points_dst, double x,
                                   double y, double z) {
  return detail::formula<"perspective_matrix3d">(std::tuple(points_src, points_dst), x, y, z);
}

inline Tensor crop_matrix_backward(Tensor const& grad, Tensor const& quads, std::optional<Tensor> const& first,
                                   double across, double down) {
  return detail::formula_gradient<"crop_matrix">(grad, std::tuple(quads, first), across, down);
}
// Homographies (B, 3, 3) from pixels of a result to the quadrangles (B, 4, 2) that it shows, from `first` (B, 2) on, or
// from its first pixel, and `across` and `down` further.
inline Tensor crop_matrix(Tensor const& quads, std::optional<Tensor> const& first, double across, double down) {
  return detail::formula<"crop_matrix">(std::tuple(quads, first), across, down);
}

inline Tensor quad_shapes_backward(Tensor const& grad, Tensor const& quads, Tensor const& others) {
  return detail::formula_gradient<"quad_shapes">(grad, std::tuple(quads, others));
}
// What opposite sides of quadrangles (B, 4, 2) and of others differ by, and the way to the others' third corner: (B,
// 6).
inline Tensor quad_shapes(Tensor const& quads, Tensor const& others) {
  return detail::formula<"quad_shapes">(std::tuple(quads, others));
}

inline Tensor essential_from_fundamental_backward(Tensor const& grad, Tensor const& fundamental, Tensor const& camera1,
                                                  Tensor const& camera2) {
  return detail::formula_gradient<"essential_from_fundamental">(grad, std::tuple(fundamental, camera1, camera2));
}
// K2^T F K1 of fundamental matrices and cameras (B, 3, 3).
inline Tensor essential_from_fundamental(Tensor const& fundamental, Tensor const& camera1, Tensor const& camera2) {
  return detail::formula<"essential_from_fundamental">(std::tuple(fundamental, camera1, camera2));
}

inline Tensor fundamental_from_essential_backward(Tensor const& grad, Tensor const& essential, Tensor const& camera1,
                                                  Tensor const& camera2) {
  return detail::formula_gradient<"fundamental_from_essential">(grad, std::tuple(essential, camera1, camera2));
}
// K2^-T E K1^-1 of essential matrices and cameras (B, 3, 3).
inline Tensor fundamental_from_essential(Tensor const& essential, Tensor const& camera1, Tensor const& camera2) {
  return detail::formula<"fundamental_from_essential">(std::tuple(essential, camera1, camera2));
}

inline Tensor fundamental_from_projections_backward(Tensor const& grad, Tensor const& projection1,
                                                    Tensor const& projection2) {
  return detail::formula_gradient<"fundamental_from_projections">(grad, std::tuple(projection1, projection2));
}
// The fundamental matrices (B, 3, 3) of two projections (B, 3, 4).
inline Tensor fundamental_from_projections(Tensor const& projection1, Tensor const& projection2) {
  return detail::formula<"fundamental_from_projections">(std::tuple(projection1, projection2));
}

inline Tensor camera_motion_backward(Tensor const& grad, Tensor const& rotation1, Tensor const& translation1,
                                     Tensor const& rotation2, Tensor const& translation2) {
  return detail::formula_gradient<"camera_motion">(grad, std::tuple(rotation1, translation1, rotation2, translation2));
}
// From a first camera, rotation (B, 3, 3) and translation (B, 3, 1), to a second: the rotation's rows, then the
// translation, (B, 4, 3).
inline Tensor camera_motion(Tensor const& rotation1, Tensor const& translation1, Tensor const& rotation2,
                            Tensor const& translation2) {
  return detail::formula<"camera_motion">(std::tuple(rotation1, translation1, rotation2, translation2));
}

inline Tensor camera_of_projection_backward(Tensor const& grad, Tensor const& projection) {
  return detail::formula_gradient<"camera_of_projection">(grad, std::tuple(projection));
}
// The rows of K and of R, and t, of projections K [R | t] (B, 3, 4): (B, 7, 3).
inline Tensor camera_of_projection(Tensor const& projection) {
  return detail::formula<"camera_of_projection">(std::tuple(projection));
}

inline Tensor essential_from_motions_backward(Tensor const& grad, Tensor const& rotation1, Tensor const& translation1,
                                              Tensor const& rotation2, Tensor const& translation2) {
  return detail::formula_gradient<"essential_from_motions">(
      grad, std::tuple(rotation1, translation1, rotation2, translation2));
}
// The essential matrices (B, 3, 3) of two cameras, rotations (B, 3, 3) and translations (B, 3, 1).
inline Tensor essential_from_motions(Tensor const& rotation1, Tensor const& translation1, Tensor const& rotation2,
                                     Tensor const& translation2) {
  return detail::formula<"essential_from_motions">(std::tuple(rotation1, translation1, rotation2, translation2));
}

}  // namespace kvision
