// Exponential maps, logarithms and Jacobians of the Lie groups SE(2), SO(3) and SE(3), as formulas
// (geometry/formula.h).
//
// With x the angle and V = [v] the skew-symmetric matrix of a rotation vector v (Solà et al., 2018; Barfoot, 2017):
//
//   left Jacobian of SO(3)   J = I + (1 - cos x) / x^2 V + (x - sin x) / x^3 V^2
//   its inverse              I - V / 2 + (1 - (x / 2) cot(x / 2)) / x^2 V^2
//   exp of SE(3)             (exp v, J rho)
//   left Jacobian of SE(3)   [J Q; 0 J], with Q of Barfoot, equation 7.86
//
// The factors are smooth functions of x^2: below 1 they are series, whose tenth term is below the rounding of double.
#pragma once

#include "core/matrix3.h"
#include "geometry/conversions/rotations.h"

namespace kv::geometry {

// --- functions of the squared angle ----------------------------------------------------------------------------------

template <class V, int N>
KV_HD V series(V const& square, double const (&coefficients)[N]) {
  V sum = constant<V>(coefficients[N - 1]);
  for (int k = N - 2; k >= 0; --k) sum = sum * square + coefficients[k];
  return sum;
}

// (x - sin x) / x^3.
template <class V>
KV_HD V sine_rest(V const& square, V const& sinc) {
  constexpr double c[] = {1 / 6.,
                          -1 / 120.,
                          1 / 5040.,
                          -1 / 362880.,
                          1 / 39916800.,
                          -1 / 6227020800.,
                          1 / 1307674368000.,
                          -1 / 355687428096000.,
                          1 / 121645100408832000.};
  return select(square < 1., series(square, c), (1. - sinc) / square);
}

// (x^2 / 2 - 1 + cos x) / x^4, of (1 - cos x) / x^2.
template <class V>
KV_HD V cosine_rest(V const& square, V const& versine) {
  constexpr double c[] = {1 / 24.,
                          -1 / 720.,
                          1 / 40320.,
                          -1 / 3628800.,
                          1 / 479001600.,
                          -1 / 87178291200.,
                          1 / 20922789888000.,
                          -1 / 6402373705728000.,
                          1 / 2432902008176640000.};
  return select(square < 1., series(square, c), (0.5 - versine) / square);
}

// (2 x - 3 sin x + x cos x) / (2 x^5).
template <class V>
KV_HD V translation_rest(V const& square, V const& sinc, V const& cosine) {
  constexpr double c[] = {1 / 120.,
                          -2 / 5040.,
                          3 / 362880.,
                          -4 / 39916800.,
                          5 / 6227020800.,
                          -6 / 1307674368000.,
                          7 / 355687428096000.,
                          -8 / 121645100408832000.,
                          9 / 51090942171709440000.};
  return select(square < 1., series(square, c), (1. - sinc * 1.5 + cosine * 0.5) / (square * square));
}

// (1 - (x / 2) cot(x / 2)) / x^2, whose series has the Bernoulli numbers |B_2n| / (2n)!.
template <class V>
KV_HD V cotangent_rest(V const& square) {
  constexpr double c[] = {1 / 12.,
                          1 / 720.,
                          1 / 30240.,
                          1 / 1209600.,
                          1 / 47900160.,
                          691 / 1307674368000.,
                          1 / 74724249600.,
                          3617 / 10670622842880000.,
                          43867 / 5109094217170944000.,
                          174611 / 802857662698291200000.,
                          77683 / 14101100039391805440000.,
                          236364091 / 1693824136731743669452800000.};
  V sinc, cosine;
  sinc_cos(square * 0.25, sinc, cosine);
  return select(square < 1., series(square, c), (1. - cosine / sinc) / square);
}

// --- 3 x 3 -----------------------------------------------------------------------------------------------------------

// a I + b V + c V^2.
template <class V>
KV_HD void skew_polynomial(V const* v, double a, V const& b, V const& c, V* m) {
  V const xx = v[0] * v[0], yy = v[1] * v[1], zz = v[2] * v[2];
  V const xy = c * v[0] * v[1], yz = c * v[1] * v[2], zx = c * v[2] * v[0];
  V const x = b * v[0], y = b * v[1], z = b * v[2];
  m[0] = a - c * (yy + zz), m[1] = xy - z, m[2] = zx + y;
  m[3] = xy + z, m[4] = a - c * (xx + zz), m[5] = yz - x;
  m[6] = zx - y, m[7] = yz + x, m[8] = a - c * (xx + yy);
}

// --- SO(3) -----------------------------------------------------------------------------------------------------------

template <class V>
KV_HD void so3_jacobian(V const* v, V* m) {
  V const square = squared_norm(v, 3);
  V half_sinc, half_cosine;
  sinc_cos(square * 0.25, half_sinc, half_cosine);
  skew_polynomial(v, 1, half_sinc * half_sinc * 0.5, sine_rest(square, half_sinc * half_cosine), m);
}

template <class V>
KV_HD void so3_jacobian_inverse(V const* v, V* m) {
  skew_polynomial(v, 1, constant<V>(-0.5), cotangent_rest(squared_norm(v, 3)), m);
}

struct So3LeftJacobian : VectorInput<3, 3, 3> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* m, FormulaOptions const&) {
    so3_jacobian(v, m);
  }
};

struct So3LeftJacobianInverse : VectorInput<3, 3, 3> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* m, FormulaOptions const&) {
    so3_jacobian_inverse(v, m);
  }
};

// --- SE(3) -----------------------------------------------------------------------------------------------------------

// (w, x, y, z, tx, ty, tz) of a translation and a rotation vector.
struct Se3Exp : VectorInput<6, 7> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* motion, FormulaOptions const&) {
    V const* const rotation = v + 3;
    V sinc, J[9];
    sinc_cos(squared_norm(rotation, 3) * 0.25, sinc, motion[0]);
    for (int i = 0; i < 3; ++i) motion[1 + i] = rotation[i] * sinc * 0.5;
    so3_jacobian(rotation, J);
    for (int i = 0; i < 3; ++i) motion[4 + i] = dot3(J + 3 * i, v);
  }
};

struct Se3Log : VectorInput<7, 6> {
  template <class V>
  static KV_HD void evaluate(V const* motion, V* v, FormulaOptions const& s) {
    V inverse[9];
    axis_angle_from_quaternion(motion, v + 3, s.min_normal);
    so3_jacobian_inverse(v + 3, inverse);
    for (int i = 0; i < 3; ++i) v[i] = dot3(inverse + 3 * i, motion + 4);
  }
};

// Q of the left Jacobian.
template <class V>
KV_HD void se3_upper_block(V const* v, V* q) {
  V const square = squared_norm(v + 3, 3);
  V half_sinc, half_cosine;
  sinc_cos(square * 0.25, half_sinc, half_cosine);
  V const versine = half_sinc * half_sinc * 0.5, sinc = half_sinc * half_cosine, cosine = 1. - square * versine;
  V const a = sine_rest(square, sinc), b = cosine_rest(square, versine), c = translation_rest(square, sinc, cosine);
  V rho[9], phi[9], phi_rho[9], rho_phi[9], phi_rho_phi[9], left[9], right[9];
  skew_matrix(v, rho);
  skew_matrix(v + 3, phi);
  multiply3(phi, rho, phi_rho);
  multiply3(rho, phi, rho_phi);
  multiply3(phi_rho, phi, phi_rho_phi);
  multiply3(phi, phi_rho, left);
  multiply3(rho_phi, phi, right);
  for (int i = 0; i < 9; ++i)
    q[i] =
        rho[i] * 0.5 + a * (phi_rho[i] + rho_phi[i] + phi_rho_phi[i]) + b * (left[i] + right[i] - phi_rho_phi[i] * 3.);
  multiply3(phi_rho_phi, phi, left);
  multiply3(phi, phi_rho_phi, right);
  for (int i = 0; i < 9; ++i) q[i] = q[i] + c * (left[i] + right[i]);
}

// [diagonal upper; 0 diagonal] (6, 6).
template <class V>
KV_HD void block_matrix(V const* diagonal, V const* upper, V* m) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      m[6 * i + j] = m[6 * (i + 3) + j + 3] = diagonal[3 * i + j];
      m[6 * i + j + 3] = upper[3 * i + j];
      m[6 * (i + 3) + j] = constant<V>(0);
    }
}

struct Se3LeftJacobian : VectorInput<6, 6, 6> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* m, FormulaOptions const&) {
    V J[9], Q[9];
    so3_jacobian(v + 3, J);
    se3_upper_block(v, Q);
    block_matrix(J, Q, m);
  }
};

struct Se3LeftJacobianInverse : VectorInput<6, 6, 6> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* m, FormulaOptions const&) {
    V inverse[9], Q[9], product[9];
    so3_jacobian_inverse(v + 3, inverse);
    se3_upper_block(v, Q);
    multiply3(inverse, Q, product);
    multiply3(product, inverse, Q);
    for (V& x : Q) x = -x;
    block_matrix(inverse, Q, m);
  }
};

// --- SE(2) -----------------------------------------------------------------------------------------------------------

// (cos, sin, x, y) of a translation and an angle.
struct Se2Exp : VectorInput<3, 4> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* motion, FormulaOptions const&) {
    V half_sinc, half_cosine;
    V const &angle = v[2], square = angle * angle;
    sinc_cos(square * 0.25, half_sinc, half_cosine);
    V const sinc = half_sinc * half_cosine, versine = half_sinc * half_sinc * 0.5 * angle;
    motion[0] = 1. - versine * angle, motion[1] = sinc * angle;
    motion[2] = sinc * v[0] - versine * v[1], motion[3] = versine * v[0] + sinc * v[1];
  }
};

struct Se2Log : VectorInput<4, 3> {
  template <class V>
  static KV_HD void evaluate(V const* motion, V* v, FormulaOptions const&) {
    V const angle = arctan2(motion[1], motion[0]), square = angle * angle;
    V const a = 1. - square * cotangent_rest(square), b = angle * 0.5;
    v[0] = a * motion[2] + b * motion[3], v[1] = a * motion[3] - b * motion[2], v[2] = angle;
  }
};

}  // namespace kv::geometry
