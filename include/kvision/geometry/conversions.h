// Rotations in all their forms, poses and points, as python/kvision/geometry has them: rows of small tensors, (B, ...),
// of one floating-point type. Quaternions are (w, x, y, z). A second derivative is an error.
#pragma once

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

inline Tensor axis_angle_to_rotation_matrix(Tensor const& axis_angle) {
  return ops::axis_angle_to_rotation_matrix(axis_angle);
}
inline Tensor axis_angle_to_quaternion(Tensor const& axis_angle) {
  return ops::quaternion_exponential(axis_angle, 0.5);
}
inline Tensor quaternion_to_axis_angle(Tensor const& quaternion) { return ops::quaternion_to_axis_angle(quaternion); }
inline Tensor quaternion_log_to_exp(Tensor const& quaternion) { return ops::quaternion_exponential(quaternion, 1); }
inline Tensor quaternion_exp_to_log(Tensor const& quaternion) { return ops::quaternion_logarithm(quaternion); }
inline Tensor normalize_quaternion(Tensor const& quaternion, double eps = 1e-12) {
  return ops::normalize_quaternion(quaternion, eps);
}
inline Tensor quaternion_to_rotation_matrix(Tensor const& quaternion) {
  return ops::quaternion_to_rotation_matrix(quaternion);
}
inline Tensor rotation_matrix_to_quaternion(Tensor const& rotation_matrix) {
  return ops::rotation_matrix_to_quaternion(rotation_matrix);
}
inline Tensor rotation_matrix_to_axis_angle(Tensor const& rotation_matrix) {
  return ops::rotation_matrix_to_axis_angle(rotation_matrix);
}
// Degrees (B,) to (B, 2, 2).
inline Tensor angle_to_rotation_matrix(Tensor const& angle) { return ops::angle_to_rotation_matrix(angle); }
inline std::tuple<Tensor, Tensor, Tensor, Tensor> quaternion_from_euler(Tensor const& roll, Tensor const& pitch,
                                                                        Tensor const& yaw) {
  Tensor const q = ops::quaternion_from_euler(roll, pitch, yaw);
  return {q.select(1, 0), q.select(1, 1), q.select(1, 2), q.select(1, 3)};
}
inline std::tuple<Tensor, Tensor, Tensor> euler_from_quaternion(Tensor const& w, Tensor const& x, Tensor const& y,
                                                                Tensor const& z) {
  Tensor const angles = ops::euler_from_quaternion(w, x, y, z);
  return {angles.select(1, 0), angles.select(1, 1), angles.select(1, 2)};
}
inline Tensor vector_to_skew_symmetric_matrix(Tensor const& vec) { return ops::cross_matrix(vec); }

// --- poses (B, 4, 4)

inline Tensor compose_transformations(Tensor const& trans_01, Tensor const& trans_12) {
  return ops::compose_poses(trans_01, trans_12);
}
inline Tensor inverse_transformation(Tensor const& trans_12) { return ops::invert_pose(trans_12); }
inline Tensor relative_transformation(Tensor const& trans_01, Tensor const& trans_02) {
  return ops::relative_pose(trans_01, trans_02);
}

// --- points (B, N, D)

namespace detail {

inline Tensor const& points(char const* op, char const* name, Tensor const& x) {
  return shaped(op, name, x, 3, "(B, N, D)");
}

}  // namespace detail

// By homographies (B or 1, D + 1, D + 1).
inline Tensor transform_points(Tensor const& trans_01, Tensor const& points_1) {
  Tensor const x = detail::floats(detail::points("transform_points", "points_1", points_1));
  return ops::transform_points(x, {}, detail::computed(trans_01, x), int64_t(ops::PointMap::transform));
}
inline Tensor project_points(Tensor const& point_3d, Tensor const& camera_matrix) {
  Tensor const x = detail::floats(detail::points("project_points", "point_3d", point_3d));
  return ops::transform_points(x, {}, detail::computed(camera_matrix, x), int64_t(ops::PointMap::project));
}
// At depth (B, N, 1), which is z, or with `normalize` a distance.
inline Tensor unproject_points(Tensor const& point_2d, Tensor const& depth, Tensor const& camera_matrix,
                               bool normalize = false) {
  Tensor const x = detail::floats(detail::points("unproject_points", "point_2d", point_2d));
  return ops::transform_points(x, detail::computed(depth, x), detail::computed(camera_matrix, x),
                               int64_t(normalize ? ops::PointMap::unproject_distance : ops::PointMap::unproject));
}

}  // namespace kvision
