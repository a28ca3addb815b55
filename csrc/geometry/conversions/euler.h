// Euler angles: formulas of kvision.geometry.conversions.euler.
#pragma once

#include "geometry/conversions/angles.h"

namespace kv::geometry {

struct QuaternionFromEuler : ScalarInputs<3> {
  static constexpr int kOutputSize = 4;
  static constexpr Extent result = {4};
  template <class V>
  static KV_HD void evaluate(V const* angles, V* q, FormulaOptions const&) {
    V s[3], c[3];
    for (int i = 0; i < 3; ++i) sin_cos(angles[i] * .5, s[i], c[i]);
    q[0] = c[0] * c[1] * c[2] + s[0] * s[1] * s[2];
    q[1] = s[0] * c[1] * c[2] - c[0] * s[1] * s[2];
    q[2] = c[0] * s[1] * c[2] + s[0] * c[1] * s[2];
    q[3] = c[0] * c[1] * s[2] - s[0] * s[1] * c[2];
  }
  // The derivative along roll is q i / 2, that along yaw is k q / 2.
  template <class V>
  static KV_HD void vjp(V const* angles, V const* grad_y, V* grad_x, FormulaOptions const& options) {
    V s[3], c[3], q[4];
    evaluate(angles, q, options);
    for (int i = 0; i < 3; ++i) sin_cos(angles[i] * .5, s[i], c[i]);
    grad_x[0] = (q[0] * grad_y[1] - q[1] * grad_y[0] + q[3] * grad_y[2] - q[2] * grad_y[3]) * .5;
    grad_x[2] = (q[0] * grad_y[3] - q[3] * grad_y[0] + q[1] * grad_y[2] - q[2] * grad_y[1]) * .5;
    grad_x[1] =
        (s[0] * c[1] * s[2] - c[0] * s[1] * c[2]) * grad_y[0] - (s[0] * s[1] * c[2] + c[0] * c[1] * s[2]) * grad_y[1];
    grad_x[1] = grad_x[1] + (c[0] * c[1] * c[2] - s[0] * s[1] * s[2]) * grad_y[2];
    grad_x[1] = (grad_x[1] - (c[0] * s[1] * s[2] + s[0] * c[1] * c[2]) * grad_y[3]) * .5;
  }
};

// E. Bernardes, S. Viollet (2022): (yaw + roll) / 2 is the angle of (a, b), (yaw - roll) / 2 that of (c, d).
struct EulerFromQuaternion : ScalarInputs<4> {
  static constexpr int kOutputSize = 3;
  static constexpr Extent result = {3};
  template <class V>
  static KV_HD V within_pi(V const& angle) {
    constexpr double turn = 6.28318530717958647693;
    return subtract_constant(angle, rounded(angle * (1 / turn)) * turn);
  }
  template <class V>
  static KV_HD void evaluate(V const* q, V* euler, FormulaOptions const& s) {
    V const zero = constant<V>(0);
    V const a = q[0] - q[2], b = q[1] + q[3], c = q[0] + q[2], d = q[3] - q[1];
    V const p = a * a + b * b, m = c * c + d * d, min_value = (p + m) * (16 * s.eps * s.eps);
    auto const up = p <= min_value, down = m <= min_value;  // both for the quaternion 0
    V const first = select(up, zero, arctan2(b, a)), second = select(down, zero, arctan2(d, c));
    V const total = select(up, select(down, first, second), first), difference = select(down, total, second);
    V const half_pi = constant<V>(1.57079632679489661923);
    V const between = arctan2(square_root(m), square_root(p)) * 2. - half_pi;
    V const at_pole = select(up, select(down, zero, half_pi), -half_pi);
    euler[0] = within_pi(total - difference);
    euler[1] = select(up, at_pole, select(down, at_pole, between));
    euler[2] = within_pi(total + difference);
  }
};

}  // namespace kv::geometry
