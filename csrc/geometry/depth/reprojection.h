// The projection from the pixels of one camera, at a depth, to the pixels of another one. For the cameras' matrices K,
// K' and their poses (R, t), (R', t') from the world,
//
//   A = K' R' R^T K^-1, b = K' (t' - R' R^T t), projection = [A | b].
//
// warp.h defines how it maps a pixel. Computes in double, because there is only one matrix for each sample.
#pragma once

#include "core/isa.h"
#include "geometry/relative_motion.h"
#include "geometry/small_matrix.h"

namespace kv::geometry {

// One matrix for each sample, or one for all.
struct Matrices {
  Reals data;
  int64_t sample, row;  // strides; sample is 0 if all share one matrix
  KV_HD double at(int64_t b, int i, int k) const { return data[b * sample + i * row + k]; }
};

template <class T>
struct ReprojectionParams {
  Matrices camera_to, pose_to, camera_from, pose_from;  // (3, 3) and (4, 4); pose_from may be null: the world frame
  int64_t batch;
  bool pinhole;      // whether only focal lengths and principal points of the cameras are used
  Reals projection;  // (B, 3, 4)
  // For the gradient only: those to the projection and to the four matrices of each sample.
  Reals grad, grad_camera_to, grad_pose_to, grad_camera_from, grad_pose_from;
};

KV_KERNEL(reprojection, ReprojectionParams)
KV_KERNEL(reprojection_backward, ReprojectionParams)

namespace small {

// The entries of a pinhole camera's matrix that are not fixed to 0 or 1.
KV_HD bool is_pinhole_entry(int i) { return i == 0 || i == 2 || i == 4 || i == 5; }

struct Cameras {
  double K_to[9], K_from_inverse[9];  // K', K^-1
  double R_to[9], t_to[3], R_from[9], t_from[3];
  double R[9], t[3];  // R' R^T, t' - R' R^T t
  bool is_invertible;

  template <class T>
  KV_HD Cameras(ReprojectionParams<T> const& p, int64_t b) {
    double from[9];
    bool const has_pose_from = p.pose_from.data.data;
    for (int i = 0; i < 9; ++i) {
      double const otherwise = i == 8;
      bool const is_read = !p.pinhole || is_pinhole_entry(i);
      K_to[i] = is_read ? p.camera_to.at(b, i / 3, i % 3) : otherwise;
      from[i] = is_read ? p.camera_from.at(b, i / 3, i % 3) : otherwise;
    }
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) {
        R_to[3 * i + k] = p.pose_to.at(b, i, k);
        R_from[3 * i + k] = has_pose_from ? p.pose_from.at(b, i, k) : i == k;
      }
      t_to[i] = p.pose_to.at(b, i, 3);
      t_from[i] = has_pose_from ? p.pose_from.at(b, i, 3) : 0;
    }
    double const determinant = inverse3(from, K_from_inverse);
    is_invertible = determinant != 0 && finite(1 / determinant);
    relative_motion(R_from, t_from, R_to, t_to, R, t);
  }
};

}  // namespace small

template <class T>
KV_HD void set_reprojection(ReprojectionParams<T> const& p, int64_t b) {
  small::Cameras const c(p, b);
  double R_K_from_inverse[9], A[9];
  multiply3(c.R, c.K_from_inverse, R_K_from_inverse);
  multiply3(c.K_to, R_K_from_inverse, A);
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) p.projection.set(12 * b + 4 * i + k, A[3 * i + k]);
    p.projection.set(12 * b + 4 * i + 3, dot3(c.K_to + 3 * i, c.t));
  }
}

// The gradient is 0 if the camera has no inverse.
template <class T>
KV_HD void reprojection_vjp(ReprojectionParams<T> const& p, int64_t b) {
  small::Cameras const c(p, b);
  double grad_a[9], grad_b[3], R_K_from_inverse[9], grad_R_K_from_inverse[9], grad_R[9], grad_t[3], g[9], h[9];
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) grad_a[3 * i + k] = p.grad[12 * b + 4 * i + k];
    grad_b[i] = p.grad[12 * b + 4 * i + 3];
  }
  auto const set = [&](Reals const& dst, int64_t index, double value) { dst.set(index, c.is_invertible ? value : 0); };
  auto const set_camera = [&](Reals const& dst, double const* value) {
    for (int i = 0; i < 9; ++i) set(dst, 9 * b + i, !p.pinhole || small::is_pinhole_entry(i) ? value[i] : 0);
  };
  auto const set_pose = [&](Reals const& dst, double const* grad_rotation, double const* grad_translation) {
    for (int i = 0; i < 16; ++i)
      set(dst, 16 * b + i, i >= 12 ? 0 : i % 4 == 3 ? grad_translation[i / 4] : grad_rotation[3 * (i / 4) + i % 4]);
  };
  multiply3(c.R, c.K_from_inverse, R_K_from_inverse);
  multiply3<false, true>(grad_a, R_K_from_inverse, g);
  for (int i = 0; i < 9; ++i) g[i] += grad_b[i / 3] * c.t[i % 3];
  set_camera(p.grad_camera_to, g);

  multiply3<true>(c.K_to, grad_a, grad_R_K_from_inverse);
  for (int i = 0; i < 3; ++i) grad_t[i] = c.K_to[i] * grad_b[0] + c.K_to[3 + i] * grad_b[1] + c.K_to[6 + i] * grad_b[2];
  multiply3<false, true>(grad_R_K_from_inverse, c.K_from_inverse, grad_R);
  double grad_t_from[3];
  relative_motion_vjp(c.R_from, c.t_from, c.R_to, c.R, grad_R, grad_t, h, grad_t_from, g);
  set_pose(p.grad_pose_to, g, grad_t);
  set_pose(p.grad_pose_from, h, grad_t_from);

  multiply3<true>(c.R, grad_R_K_from_inverse, g);  // to K^-1
  multiply3<true>(c.K_from_inverse, g, h);         // to K: -K^-T g K^-T
  multiply3<false, true>(h, c.K_from_inverse, g);
  for (double& value : g) value = -value;
  set_camera(p.grad_camera_from, g);
}

}  // namespace kv::geometry
