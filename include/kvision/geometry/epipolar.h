// Two views of points, as python/kvision/geometry/epipolar has them. Points are (B, N, 2), matrices (B, 3, 3),
// translations (B, 3, 1) and projections (B, 3, 4). A second derivative is an error.
#pragma once

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

// The fundamental matrices of eight points and more, with weights (B, N).
inline Tensor find_fundamental(Tensor const& points1, Tensor const& points2,
                               std::optional<Tensor> const& weights = {}) {
  detail::same_shape("find_fundamental", "points2", points2,
                     detail::shaped("find_fundamental", "points1", points1, 3, "(B, N, 2)"));
  return ops::fundamental_dlt(points1, points2, weights);
}
inline Tensor fundamental_from_essential(Tensor const& E_mat, Tensor const& K1, Tensor const& K2) {
  return ops::fundamental_from_essential(E_mat, K1, K2);
}
inline Tensor fundamental_from_projections(Tensor const& P1, Tensor const& P2) {
  return ops::fundamental_from_projections(P1, P2);
}
inline Tensor essential_from_fundamental(Tensor const& F_mat, Tensor const& K1, Tensor const& K2) {
  return ops::essential_from_fundamental(F_mat, K1, K2);
}
inline Tensor essential_from_Rt(Tensor const& R1, Tensor const& t1, Tensor const& R2, Tensor const& t2) {
  return ops::essential_from_motions(R1, t1, R2, t2);
}
inline Tensor project_to_essential(Tensor const& E_mat) { return ops::nearest_essential(E_mat); }

// The rotation (B, 3, 3) and the translation (B, 3, 1) from a first camera to a second.
inline std::tuple<Tensor, Tensor> relative_camera_motion(Tensor const& R1, Tensor const& t1, Tensor const& R2,
                                                         Tensor const& t2) {
  Tensor const motion = ops::camera_motion(R1, t1, R2, t2);
  return {motion.narrow(1, 0, 3), motion.select(1, 3).unsqueeze(2)};
}
// The four motions of essential matrices: rotations (B, 4, 3, 3), directions of translations (B, 4, 3, 1).
inline std::tuple<Tensor, Tensor> motion_from_essential(Tensor const& E_mat) { return ops::essential_motions(E_mat); }
// The two rotations and the direction.
inline std::tuple<Tensor, Tensor, Tensor> decompose_essential_matrix(Tensor const& E_mat) {
  auto const [R, t] = ops::essential_motions(E_mat);
  return {R.select(1, 0), R.select(1, 2), t.select(1, 0)};
}
// The motion that leaves most points in front of both cameras, by a mask (B, N) of those that count: rotation,
// translation, points in space (B, N, 3) and how many are in front (B). C++ has no gradient of it.
inline std::tuple<Tensor, Tensor, Tensor, Tensor> motion_from_essential_choose_solution(
    Tensor const& E_mat, Tensor const& K1, Tensor const& K2, Tensor const& x1, Tensor const& x2,
    std::optional<Tensor> const& mask = {}) {
  auto const [R, t, X, in_front, index] = ops::motion_choice(E_mat, K1, K2, x1, x2, mask);
  return {R, t, X, in_front};
}

// K (B, 3, 3), R (B, 3, 3) and t (B, 3, 1) of projections K [R | t].
inline std::tuple<Tensor, Tensor, Tensor> KRt_from_projection(Tensor const& P) {
  Tensor const parts = ops::decompose_projection(P);
  return {parts.narrow(1, 0, 3), parts.narrow(1, 3, 3), parts.select(1, 6).unsqueeze(2)};
}
// Points in space (B, N, 3) from their projections.
inline Tensor triangulate_points(Tensor const& P1, Tensor const& P2, Tensor const& points1, Tensor const& points2) {
  detail::same_shape("triangulate_points", "points2", points2,
                     detail::shaped("triangulate_points", "points1", points1, 3, "(B, N, 2)"));
  return ops::triangulate(points1, points2, P1, P2);
}
// Points about 0 at a mean distance of sqrt(2), and the similarity (B, 3, 3) that takes the given ones there.
inline std::tuple<Tensor, Tensor> normalize_points(Tensor const& points, double eps = 1e-8,
                                                   std::optional<Tensor> const& weights = {}) {
  return ops::normalize_points(detail::shaped("normalize_points", "points", points, 3, "(B, N, 2)"), weights, eps);
}

// --- distances (B, N)

inline Tensor sampson_epipolar_distance(Tensor const& pts1, Tensor const& pts2, Tensor const& Fm, bool squared = true) {
  return ops::correspondence_errors(pts1, pts2, Fm, int64_t(ops::CorrespondenceError::sampson), squared);
}
inline Tensor symmetrical_epipolar_distance(Tensor const& pts1, Tensor const& pts2, Tensor const& Fm,
                                            bool squared = true) {
  return ops::correspondence_errors(pts1, pts2, Fm, int64_t(ops::CorrespondenceError::symmetrical), squared);
}
inline Tensor left_to_right_epipolar_distance(Tensor const& pts1, Tensor const& pts2, Tensor const& Fm) {
  return ops::correspondence_errors(pts1, pts2, Fm, int64_t(ops::CorrespondenceError::right), false);
}
inline Tensor right_to_left_epipolar_distance(Tensor const& pts1, Tensor const& pts2, Tensor const& Fm) {
  return ops::correspondence_errors(pts1, pts2, Fm, int64_t(ops::CorrespondenceError::left), false);
}

}  // namespace kvision
