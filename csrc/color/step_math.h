// The functions that formulas of color steps use: functions of Duals, clipping, powers, affine maps. Included by
// steps.h and the files of formulas, after log2_of, exp2_of, floor_of, absolute, reciprocal, quotient, nan_max and
// nan_min of numbers and Lanes.
#pragma once

#include "core/dual.h"
#include "program.h"

namespace kv::color {

template <class V, int N>
KV_HD Dual<V, N> log2_of(Dual<V, N> a) {
  V const derivative = reciprocal(a.value) * Scalar<V>(1.44269504088896340736);
  a.value = log2_of(a.value);
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * derivative;
  return a;
}
template <class V, int N>
KV_HD Dual<V, N> exp2_of(Dual<V, N> a) {
  a.value = exp2_of(a.value);
  V const derivative = a.value * Scalar<V>(0.69314718055994530942);
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * derivative;
  return a;
}
template <class V, int N>
KV_HD Dual<V, N> reciprocal(Dual<V, N> a) {
  a.value = reciprocal(a.value);
  V const derivative = -a.value * a.value;
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * derivative;
  return a;
}
// 1 / b in derivatives, which stay finite: no more than a sixteenth of the largest number.
template <class V>
KV_HD V finite_reciprocal(V const& b) {
  using F = Scalar<V>;
  constexpr F smallest = sizeof(F) == 4 ? F(0x1p-124) : F(0x1p-1020);
  return reciprocal(select(absolute(b) < smallest, constant<V>(smallest), b));
}
template <class V, int N>
KV_HD Dual<V, N> quotient(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c;
  c.value = quotient(a.value, b.value);
  V const inverse = finite_reciprocal(b.value);
  for (int i = 0; i < N; ++i) c.d[i] = (a.d[i] - c.value * b.d[i]) * inverse;
  return c;
}
template <class V, int N>
KV_HD Dual<V, N> absolute(Dual<V, N> const& a) {
  return select(a.value < Scalar<V>(0), -a, a);
}
// The floor as a plain value, because its derivative is 0.
template <class V, int N>
KV_HD V floor_of(Dual<V, N> const& a) {
  return floor_of(a.value);
}

// Where arguments tie, the derivative is split evenly among them.
template <class V, int N>
KV_HD Dual<V, N> nan_max(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c = select(a.value > b.value, a, select(b.value > a.value, b, (a + b) * Scalar<V>(0.5)));
  c.value = nan_max(a.value, b.value);
  return c;
}
template <class V, int N>
KV_HD Dual<V, N> nan_min(Dual<V, N> const& a, Dual<V, N> const& b) {
  return -nan_max(-a, -b);
}
// 1 where numbers are equal, else 0. Numbers on CUDA have functions of their own.
template <class V>
KV_HD V equality(V const& a, V const& b) {
  using F = Scalar<V>;
  return select(a == b, constant<V>(F(1)), constant<V>(F(0)));
}
// 1 / n for n = 1, 2, 3.
template <class V>
KV_HD V share_of(V const& n) {
  using F = Scalar<V>;
  V const one = constant<V>(F(1));
  return select(n > F(2), constant<V>(F(1. / 3)), select(n > F(1), constant<V>(F(0.5)), one));
}
// The channels that equal `extreme`: 1 for each, 0 for the others, and the share of each.
template <class V>
struct TieWeights {
  V equal[3], share;
  KV_HD TieWeights(V const (&c)[3], V const& extreme)
      : equal{equality(c[0], extreme), equality(c[1], extreme), equality(c[2], extreme)},
        share(share_of(V(equal[0] + equal[1] + equal[2]))) {}
};
template <class V>
KV_HD V largest(V const (&c)[3]) {
  return nan_max(nan_max(c[0], c[1]), c[2]);
}
template <class V>
KV_HD V smallest(V const (&c)[3]) {
  return nan_min(nan_min(c[0], c[1]), c[2]);
}
template <class V, int N>
KV_HD Dual<V, N> with_even_derivatives(V const& extreme, V const (&values)[3], Dual<V, N> const (&c)[3]) {
  TieWeights<V> const ties(values, extreme);
  Dual<V, N> y{extreme, {}};
  for (int i = 0; i < N; ++i)
    y.d[i] = (c[0].d[i] * ties.equal[0] + c[1].d[i] * ties.equal[1] + c[2].d[i] * ties.equal[2]) * ties.share;
  return y;
}
template <class V, int N>
KV_HD Dual<V, N> largest(Dual<V, N> const (&c)[3]) {
  V const values[3] = {c[0].value, c[1].value, c[2].value};
  return with_even_derivatives(largest(values), values, c);
}
template <class V, int N>
KV_HD Dual<V, N> smallest(Dual<V, N> const (&c)[3]) {
  V const values[3] = {c[0].value, c[1].value, c[2].value};
  return with_even_derivatives(smallest(values), values, c);
}
// Clamps a; NaN stays NaN.
template <class V, class F = Scalar<V>>
KV_HD V clamp_min(V const& a, F low) {
  if constexpr (kIsDual<V>)
    return select(a < low, constant<V>(low), a);
  else
    return nan_max(a, constant<V>(low));
}
template <class V, class F = Scalar<V>>
KV_HD V clamp_max(V const& a, F high) {
  if constexpr (kIsDual<V>)
    return select(a > high, constant<V>(high), a);
  else
    return nan_min(a, constant<V>(high));
}

// f(x) of one number. f is evaluated with one derivative, however many x has.
template <class V, class Formula>
KV_HD V map_scalar(V x, Formula f) {
  if constexpr (kIsDual<V>) {
    using Value = decltype(x.value);
    Dual<Value, 1> const y = with_derivative(x.value, f);
    x.value = y.value;
    for (auto& d : x.d) d = d * y.d[0];
    return x;
  } else {
    return f(x);
  }
}
// f(x) and its derivative.
template <class V, class Formula>
KV_HD Dual<V, 1> with_derivative(V const& x, Formula f) {
  return f(Dual<V, 1>{x, {constant<V>(Scalar<V>(1))}});
}
// x^exponent of positive numbers.
template <class V>
KV_HD V power(V const& x, Scalar<V> exponent) {
  return exp2_of(log2_of(x) * exponent);
}
// x modulo n, in [0, n).
template <class V>
KV_HD V modulo(V const& x, Scalar<V> n) {
  return subtract_constant(x, floor_of(x * (Scalar<V>(1) / n)) * n);
}

constexpr double kTwoPi = 6.283185307179586476925;

// x in [0, 1]; NaN stays NaN. Numbers on CUDA have functions of their own.
template <class V>
KV_HD V clamp_to_unit(V const& x) {
  using F = Scalar<V>;
  return clamp_max(clamp_min(x, F(0)), F(1));
}
// The same for several numbers that are NaN together, where NaN may become a number: with_nan_of(y, x) brings it back
// to x, for any y that is finite or NaN as they are.
template <class V>
KV_HD V saturate(V const& x) {
  return clamp_to_unit(x);
}
template <class V>
KV_HD V with_nan_of(V const&, V const& x) {
  return x;
}
// The gradient of x from that of clamp_to_unit(x).
template <class V>
KV_HD V clamp_to_unit_vjp(V const& x, V const& g) {
  using F = Scalar<V>;
  V const zero = constant<V>(F(0));
  return select(x < F(0), zero, select(x > F(1), zero, g));
}
template <class V>
KV_HD V clip(V const& x, bool enabled) {
  return enabled ? clamp_to_unit(x) : x;
}
template <class V>
KV_HD void affine(V (&c)[3], Scalar<V> const* m) {
  V const a = c[0], b = c[1], d = c[2];
  for (int i = 0; i < 3; ++i) c[i] = a * m[3 * i] + b * m[3 * i + 1] + d * m[3 * i + 2] + m[9 + i];
}
// The gradient of x from that of clip(x, enabled).
template <class V>
KV_HD V clip_vjp(V const& x, V const& g, bool enabled) {
  return enabled ? clamp_to_unit_vjp(x, g) : g;
}
template <class V>
KV_HD void linear_vjp(V (&g)[3], Scalar<V> const* m) {
  V const a = g[0], b = g[1], d = g[2];
  for (int i = 0; i < 3; ++i) g[i] = a * m[i] + b * m[3 + i] + d * m[6 + i];
}
// m[12] is whether the result is clipped.
template <class V>
KV_HD void affine_vjp(V const (&c)[3], V (&g)[3], Scalar<V> const* m) {
  V y[3] = {c[0], c[1], c[2]};
  affine(y, m);
  for (int i = 0; i < 3; ++i) g[i] = clip_vjp(y[i], g[i], m[12] != 0);
  linear_vjp(g, m);
}

}  // namespace kv::color
