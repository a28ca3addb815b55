// Rotation matrices, quaternions (w, x, y, z) and axis-angle vectors: formulas of
// kvision.geometry.conversions.rotations.
#pragma once

#include "geometry/conversions/angles.h"

namespace kv::geometry {

// O. Rodrigues (1840): cos + (1 - cos) a a^T + sin [a].
template <class V>
KV_HD void rotation_from_axis_angle(V const* v, V* m) {
  V sinc, cosine;
  sinc_cos(squared_norm(v, 3) * .25, sinc, cosine);
  V const versine = sinc * sinc * .5, sine = sinc * cosine;  // (1 - cos) / angle^2, sin / angle
  V const xx = v[0] * v[0] * versine, yy = v[1] * v[1] * versine, zz = v[2] * v[2] * versine;
  V const xy = v[0] * v[1] * versine, yz = v[1] * v[2] * versine, zx = v[2] * v[0] * versine;
  V const x = v[0] * sine, y = v[1] * sine, z = v[2] * sine;
  m[0] = 1. - yy - zz, m[1] = xy - z, m[2] = zx + y;
  m[3] = xy + z, m[4] = 1. - zz - xx, m[5] = yz - x;
  m[6] = zx - y, m[7] = yz + x, m[8] = 1. - xx - yy;
}

struct AxisAngleToRotationMatrix : VectorInput<3, 3, 3> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* m, FormulaOptions const&) {
    rotation_from_axis_angle(v, m);
  }
};

// The quaternion of a rotation by 2 * scale times the length of a vector, about it.
struct QuaternionExponential : VectorInput<3, 4> {
  static constexpr int kScalars = 1;
  template <class V>
  static KV_HD void evaluate(V const* v, V* q, FormulaOptions const& s) {
    double const scale = s.scalars[0];
    V sinc;
    sinc_cos(squared_norm(v, 3) * (scale * scale), sinc, q[0]);
    for (int i = 0; i < 3; ++i) q[1 + i] = v[i] * scale * sinc;
  }
};

template <class V>
KV_HD void axis_angle_from_quaternion(V const* q, V* v, double min_normal) {
  auto const is_negated = q[0] < 0.;  // q and -q are one rotation
  V const angle_over_norm = angle_over_sine(squared_norm(q + 1, 3), select(is_negated, -q[0], q[0]), min_normal) * 2.;
  V const factor = select(is_negated, -angle_over_norm, angle_over_norm);
  for (int i = 0; i < 3; ++i) v[i] = q[1 + i] * factor;
}

struct QuaternionToAxisAngle : VectorInput<4, 3> {
  template <class V>
  static KV_HD void evaluate(V const* q, V* v, FormulaOptions const& s) {
    axis_angle_from_quaternion(q, v, s.min_normal);
  }
};

struct QuaternionLogarithm : VectorInput<4, 3> {
  template <class V>
  static KV_HD void evaluate(V const* q, V* v, FormulaOptions const& s) {
    V const factor = angle_over_sine(squared_norm(q + 1, 3), q[0], s.min_normal);
    for (int i = 0; i < 3; ++i) v[i] = q[1 + i] * factor;
  }
};

struct NormalizeQuaternion : VectorInput<4, 4> {
  static constexpr int kScalars = 1;
  template <class V>
  static KV_HD void evaluate(V const* q, V* unit, FormulaOptions const& s) {
    double const min_value = s.scalars[0];
    V const square = squared_norm(q, 4);
    V const length = select(square <= min_value * min_value, constant<V>(min_value), square_root(square));
    for (int i = 0; i < 4; ++i) unit[i] = q[i] / length;
  }
};

struct QuaternionToRotationMatrix : VectorInput<4, 3, 3> {
  template <class V>
  static KV_HD void evaluate(V const* q, V* m, FormulaOptions const& s) {
    V const square = squared_norm(q, 4), twice = select(square < s.min_normal, constant<V>(0), constant<V>(2) / square);
    V const &x = q[1], &y = q[2], &z = q[3];
    V const w2 = q[0] * twice, x2 = x * twice, y2 = y * twice, z2 = z * twice;
    m[0] = 1. - y2 * y - z2 * z, m[1] = x2 * y - w2 * z, m[2] = x2 * z + w2 * y;
    m[3] = x2 * y + w2 * z, m[4] = 1. - x2 * x - z2 * z, m[5] = y2 * z - w2 * x;
    m[6] = x2 * z - w2 * y, m[7] = y2 * z + w2 * x, m[8] = 1. - x2 * x - y2 * y;
  }
};

// Starts from the largest component: each row below is the quaternion times 4 times one component (S. W. Shepperd,
// 1978).
template <class V>
KV_HD void quaternion_from_rotation(V const* m, V* q) {
  V const &a = m[0], &e = m[4], &i = m[8];
  V const x = m[7] - m[5], y = m[2] - m[6], z = m[3] - m[1];
  V const xy = m[1] + m[3], zx = m[2] + m[6], yz = m[5] + m[7];
  auto const by_w = a + e + i > 0., x_over_y = a >= e, x_over_z = a >= i, y_over_z = e >= i;
  V const w_row[] = {1. + a + e + i, x, y, z}, x_row[] = {x, 1. + a - e - i, xy, zx};
  V const y_row[] = {y, xy, 1. - a + e - i, yz}, z_row[] = {z, zx, yz, 1. - a - e + i};
  V row[4];
  for (int k = 0; k < 4; ++k) {
    V const with_x = select(x_over_z, x_row[k], z_row[k]), with_y = select(y_over_z, y_row[k], z_row[k]);
    row[k] = select(by_w, w_row[k], select(x_over_y, with_x, with_y));
  }
  V const largest_xyz = select(x_over_y, select(x_over_z, row[1], row[3]), select(y_over_z, row[2], row[3]));
  V const twice = square_root(select(by_w, row[0], largest_xyz)) * 2.;
  for (int k = 0; k < 4; ++k) q[k] = row[k] / twice;
}

struct RotationMatrixToQuaternion : VectorInput<9, 4> {
  static constexpr Extent extent(int) { return {3, 3}; }
  template <class V>
  static KV_HD void evaluate(V const* m, V* q, FormulaOptions const&) {
    quaternion_from_rotation(m, q);
  }
};

template <class V>
KV_HD void skew_matrix(V const* v, V* m) {
  m[0] = m[4] = m[8] = constant<V>(0);
  m[1] = -v[2], m[2] = v[1], m[3] = v[2], m[5] = -v[0], m[6] = -v[1], m[7] = v[0];
}

struct CrossMatrix : VectorInput<3, 3, 3> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* m, FormulaOptions const&) {
    skew_matrix(v, m);
  }
};

struct RotationMatrixToAxisAngle : VectorInput<9, 3> {
  static constexpr Extent extent(int) { return {3, 3}; }
  template <class V>
  static KV_HD void evaluate(V const* m, V* v, FormulaOptions const& s) {
    V q[4];
    quaternion_from_rotation(m, q);
    axis_angle_from_quaternion(q, v, s.min_normal);
  }
};

}  // namespace kv::geometry
