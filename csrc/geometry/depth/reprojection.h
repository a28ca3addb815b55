// From the pixels of one camera, at a depth, to those of another: with K and K' the matrices of the cameras, (R, t) and
// (R', t') their poses, rotations and translations from the world to each,
//
//   A = K' R' R^T K^-1,   b = K' (t' - R' R^T t),   projection = [A | b]
//
// which warp.h says how to use. In double: it is a matrix a sample. Included by reprojection_cpu.cpp,
// reprojection.cu and reprojection_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"

namespace kv {

// A matrix for each sample, or one for all.
struct Matrices {
  Reals data;
  int64_t sample, row;  // strides, the former 0 where one serves all
  KV_HD double at(int64_t b, int i, int k) const { return data[b * sample + i * row + k]; }
};

template <class T>
struct Reprojections {
  Matrices camera_to, pose_to, camera_from, pose_from;  // (3, 3) and (4, 4); the last may be null: the world's
  int64_t batch;
  bool pinhole;      // of the cameras only focal lengths and principal points are used
  Reals projection;  // (B, 3, 4)
  // For the gradient only: that to the projection, and those to the four, of each sample.
  Reals grad, to_camera_to, to_pose_to, to_camera_from, to_pose_from;
};

KV_KERNEL(reprojection, Reprojections)
KV_KERNEL(reprojection_backward, Reprojections)

namespace small {

// What a pinhole camera's matrix has beside zeros and a 1.
KV_HD bool of_pinhole(int i) { return i == 0 || i == 2 || i == 4 || i == 5; }

struct Cameras {
  double to[9], inverse[9];  // K', K^-1
  double turn_to[9], move_to[3], turn_from[9], move_from[3];
  double turn[9], move[3];  // R' R^T, t' - R' R^T t
  bool regular;

  template <class T>
  KV_HD Cameras(Reprojections<T> const& p, int64_t b) {
    double from[9], of_rows[9];
    bool const posed = p.pose_from.data.data;
    for (int i = 0; i < 9; ++i) {
      double const rest = i == 8;
      bool const given = !p.pinhole || of_pinhole(i);
      to[i] = given ? p.camera_to.at(b, i / 3, i % 3) : rest;
      from[i] = given ? p.camera_from.at(b, i / 3, i % 3) : rest;
    }
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) {
        turn_to[3 * i + k] = p.pose_to.at(b, i, k);
        turn_from[3 * i + k] = posed ? p.pose_from.at(b, i, k) : i == k;
      }
      move_to[i] = p.pose_to.at(b, i, 3);
      move_from[i] = posed ? p.pose_from.at(b, i, 3) : 0;
    }
    cofactors(from, of_rows);
    double const determinant = dot3(from, of_rows);
    regular = determinant != 0 && finite(1 / determinant);
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) inverse[3 * i + k] = of_rows[3 * k + i] / determinant;
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) turn[3 * i + k] = dot3(turn_to + 3 * i, turn_from + 3 * k);
      move[i] = move_to[i] - dot3(turn + 3 * i, move_from);
    }
  }
};

// c = a^T b, c = a b^T.
KV_HD void multiply_transposed(double const* a, double const* b, double* c) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c[3 * i + j] = a[i] * b[j] + a[3 + i] * b[3 + j] + a[6 + i] * b[6 + j];
}
KV_HD void multiply_by_transpose(double const* a, double const* b, double* c) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c[3 * i + j] = dot3(a + 3 * i, b + 3 * j);
}

}  // namespace small

template <class T>
KV_HD void reprojection_of(Reprojections<T> const& p, int64_t b) {
  small::Cameras const c(p, b);
  double turned[9], seen[9];
  small::multiply(c.turn, c.inverse, turned);
  small::multiply(c.to, turned, seen);
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) p.projection.set(12 * b + 4 * i + k, seen[3 * i + k]);
    p.projection.set(12 * b + 4 * i + 3, small::dot3(c.to + 3 * i, c.move));
  }
}

// 0 where the camera has no inverse.
template <class T>
KV_HD void reprojection_vjp(Reprojections<T> const& p, int64_t b) {
  small::Cameras const c(p, b);
  double to_a[9], to_b[3], turned[9], to_turned[9], to_turn[9], to_move[3], g[9], h[9];
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) to_a[3 * i + k] = p.grad[12 * b + 4 * i + k];
    to_b[i] = p.grad[12 * b + 4 * i + 3];
  }
  auto const set = [&](Reals const& to, int64_t at, double value) { to.set(at, c.regular ? value : 0); };
  auto const set_camera = [&](Reals const& to, double const* value) {
    for (int i = 0; i < 9; ++i) set(to, 9 * b + i, !p.pinhole || small::of_pinhole(i) ? value[i] : 0);
  };
  auto const set_pose = [&](Reals const& to, double const* turn, double const* move) {
    for (int i = 0; i < 16; ++i)
      set(to, 16 * b + i, i >= 12 ? 0 : i % 4 == 3 ? move[i / 4] : turn[3 * (i / 4) + i % 4]);
  };
  small::multiply(c.turn, c.inverse, turned);
  small::multiply_by_transpose(to_a, turned, g);
  for (int i = 0; i < 9; ++i) g[i] += to_b[i / 3] * c.move[i % 3];
  set_camera(p.to_camera_to, g);

  small::multiply_transposed(c.to, to_a, to_turned);
  for (int i = 0; i < 3; ++i) to_move[i] = c.to[i] * to_b[0] + c.to[3 + i] * to_b[1] + c.to[6 + i] * to_b[2];
  small::multiply_by_transpose(to_turned, c.inverse, to_turn);
  for (int i = 0; i < 9; ++i) to_turn[i] -= to_move[i / 3] * c.move_from[i % 3];
  small::multiply(to_turn, c.turn_from, g);
  set_pose(p.to_pose_to, g, to_move);

  double to_move_from[3];
  small::multiply_transposed(to_turn, c.turn_to, g);
  for (int i = 0; i < 3; ++i)
    to_move_from[i] = -(c.turn[i] * to_move[0] + c.turn[3 + i] * to_move[1] + c.turn[6 + i] * to_move[2]);
  set_pose(p.to_pose_from, g, to_move_from);

  small::multiply_transposed(c.turn, to_turned, g);  // to K^-1
  small::multiply_transposed(c.inverse, g, h);       // to K: -K^-T g K^-T
  small::multiply_by_transpose(h, c.inverse, g);
  for (double& value : g) value = -value;
  set_camera(p.to_camera_from, g);
}

}  // namespace kv
