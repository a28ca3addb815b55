// Functions of an angle, and the formulas of kvision.geometry.conversions.angles. Included by formulas.h and by the
// other formulas of angles.
//
// Where a value is 0 / 0 at an angle of 0, a series in the square of the angle replaces it near 0. The branch that a
// `select` does not take may then be NaN, also in the derivatives of a Dual.
#pragma once

#include "core/trigonometry.h"
#include "geometry/formula.h"

namespace kv::geometry {

// sin(x) / x and cos(x) of x squared.
template <class V>
KV_HD void sinc_cos(V const& square, V& sinc, V& cosine) {
  V const x = square_root(square);
  V sine;
  sin_cos(x, sine, cosine);
  auto const small = square < 1e-3;
  sinc = select(small, 1. - square * (1 / 6.) * (1. - square * (1 / 20.) * (1. - square * (1 / 42.))), sine / x);
  cosine = select(small, 1. - square * .5 * (1. - square * (1 / 12.) * (1. - square * (1 / 30.))), cosine);
}

// atan2(s, c) / s of s squared; 0 where s is 0 and c is not positive.
template <class V>
KV_HD V angle_over_sine(V const& sine, V const& cosine, double min_normal) {
  V const square = cosine * cosine, ratio = sine / square, s = square_root(sine);
  V const series = (1. - ratio * (1 / 3. - ratio * (1 / 5. - ratio * (1 / 7.)))) / cosine;
  V const angle = select(sine < min_normal, constant<V>(0), arctan2(s, cosine) / s);
  return select(cosine > 0., select(sine < square * 1e-4, series, angle), angle);
}

// Cosine and sine of degrees, exact at quarter turns.
template <class V>
KV_HD void cos_sin_degrees(V const& degrees, V& cosine, V& sine) {
  auto const quarters = rounded(degrees * (1 / 90.));
  V const rest = subtract_constant(degrees, quarters * 90.) * 0.017453292519943295769;
  V s, c;
  sin_cos_near_zero(rest, s, c);
  auto const turn = quarters - rounded(quarters * .25) * 4.;  // -2 and 2 are the same turn
  V const half_c = select(turn * turn == 4., -c, c), half_s = select(turn * turn == 4., -s, s);
  cosine = select(turn == 1., -s, select(turn == -1., s, half_c)) + 0.;  // no negative zeros
  sine = select(turn == 1., c, select(turn == -1., -c, half_s)) + 0.;
}

template <class V>
KV_HD V tangent(V const& angle) {
  V s, c;
  sin_cos(angle, s, c);
  return s / c;
}

template <class V>
KV_HD V squared_norm(V const* x, int n) {
  V sum = x[0] * x[0];
  for (int i = 1; i < n; ++i) sum = sum + x[i] * x[i];
  return sum;
}

struct AngleToRotationMatrix : ScalarInputs<1> {
  static constexpr int kOutputSize = 4;
  static constexpr Extent result = {2, 2};
  template <class V>
  static KV_HD void evaluate(V const* degrees, V* m, FormulaOptions const&) {
    cos_sin_degrees(degrees[0], m[0], m[1]);
    m[2] = -m[1] + 0., m[3] = m[0];
  }
  template <class V>
  static KV_HD void vjp(V const* degrees, V const* grad_m, V* grad_degrees, FormulaOptions const&) {
    V cosine, sine;
    cos_sin_degrees(degrees[0], cosine, sine);
    V const by_radians = (grad_m[1] - grad_m[2]) * cosine - (grad_m[0] + grad_m[3]) * sine;
    grad_degrees[0] = by_radians * 0.017453292519943295769;
  }
};

}  // namespace kv::geometry
