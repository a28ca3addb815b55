// What the steps of a colour program do to a pixel c, as formulas on a value type V: a number, Lanes, or Duals of
// either, whose derivatives then are those of the step. Included by program_cpu.cpp after core/lanes.h, and by
// program.cu, which bring vlog2, vexp2, vfloor and vabs for numbers.
//
// Derivatives stay finite: where a branch is not taken, what it divides by or raises to a power is replaced first.
#pragma once

#include "core/dual.h"
#include "program.h"

namespace kv {

template <class V, int N>
KV_HD Dual<V, N> log2_of(Dual<V, N> a);
template <class V, int N>
KV_HD Dual<V, N> exp2_of(Dual<V, N> a);
template <class V>
KV_HD V log2_of(V a) {
  using F = Scalar<V>;
  return vlog2<F, sizeof(V) / sizeof(F)>(a);
}
template <class V>
KV_HD V exp2_of(V a) {
  using F = Scalar<V>;
  return vexp2<F, sizeof(V) / sizeof(F)>(a);
}
template <class V>
KV_HD V floor_of(V a) {
  return vfloor(a);
}
template <class V, int N>
KV_HD Dual<V, N> log2_of(Dual<V, N> a) {
  V const slope = Scalar<V>(1.44269504088896340736) / a.value;
  a.value = log2_of(a.value);
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * slope;
  return a;
}
template <class V, int N>
KV_HD Dual<V, N> exp2_of(Dual<V, N> a) {
  a.value = exp2_of(a.value);
  V const slope = a.value * Scalar<V>(0.69314718055994530942);
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * slope;
  return a;
}
// The floor as a plain value: its derivative is 0.
template <class V, int N>
KV_HD V floor_of(Dual<V, N> const& a) {
  return floor_of(a.value);
}

// The smaller and the larger of two; NaN if one of them is.
template <class V>
KV_HD V smaller(V const& a, V const& b) {
  return select(b >= a, a, select(a == a, b, a));
}
template <class V>
KV_HD V larger(V const& a, V const& b) {
  return select(b <= a, a, select(a == a, b, a));
}
template <class V, class F = Scalar<V>>
KV_HD V at_least(V const& a, F low) {
  return select(a < low, constant<V>(low), a);
}
template <class V, class F = Scalar<V>>
KV_HD V at_most(V const& a, F high) {
  return select(a > high, constant<V>(high), a);
}
// x^exponent of positive numbers.
template <class V>
KV_HD V power(V const& x, Scalar<V> exponent) {
  return exp2_of(log2_of(x) * exponent);
}
// x modulo n, in [0, n).
template <class V>
KV_HD V modulo(V const& x, Scalar<V> n) {
  return minus(x, floor_of(x * (Scalar<V>(1) / n)) * n);
}

constexpr double kTurn = 6.283185307179586476925;

// --- hue
// ----------------------------------------------------------------------------------------------------------------

// Hue in radians from the largest channel and how far it is above the smallest; 0 for greys.
template <class V>
KV_HD V hue_of(V const (&c)[3], V const& most, V const& range, Scalar<V> eps) {
  using F = Scalar<V>;
  auto const grey = range == F(0);
  V const reciprocal = constant<V>(F(1)) / select(grey, constant<V>(F(1)), range + eps);
  V const sixths = select(most == c[0], (c[1] - c[2]) * reciprocal,
                          select(most == c[1], (c[2] - c[0]) * reciprocal + F(2), (c[0] - c[1]) * reciprocal + F(4)));
  V const positive = select(sixths < F(0), sixths + F(6), sixths);
  V const hue = select(positive >= F(6), positive - F(6), positive) * F(kTurn / 6);  // what rounds up to a turn
  return select(grey, constant<V>(F(0)), hue);
}

template <class V>
KV_HD void rgb_to_hsv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  V const most = larger(larger(c[0], c[1]), c[2]), range = most - smaller(smaller(c[0], c[1]), c[2]);
  V const hue = hue_of(c, most, range, F(0));
  c[1] = range / select(most == F(0), constant<V>(F(1)), most + eps);
  c[0] = hue;
  c[2] = most;
}

// v - v s max(0, min(k, 4 - k, 1)) with k = 5, 3, 1 sixths of a turn from the hue (A. R. Smith's sectors as one line).
template <class V>
KV_HD void hsv_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const sixths = c[0] * F(6 / kTurn), depth = c[2] * c[1], v = c[2];
  for (int i = 0; i < 3; ++i) {
    V const k = modulo(sixths + F(5 - 2 * i), F(6));
    c[i] = v - depth * at_least(at_most(smaller(k, F(4) - k), F(1)), F(0));
  }
}

template <class V>
KV_HD void rgb_to_hls(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  V const most = larger(larger(c[0], c[1]), c[2]), least = smaller(smaller(c[0], c[1]), c[2]);
  V const range = most - least, sum = most + least;
  V const hue = hue_of(c, most, range, eps), room = select(sum < F(1), sum, F(2) - sum);
  c[0] = hue;
  c[1] = sum * F(0.5);
  c[2] = range / select(room == F(0), constant<V>(F(1)), room + eps);
}

// l - s min(l, 1 - l) max(-1, min(k - 3, 9 - k, 1)), k = 0, 8, 4 twelfths of a turn from the hue.
template <class V>
KV_HD void hls_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const twelfths = c[0] * F(12 / kTurn), l = c[1], depth = c[2] * smaller(l, F(1) - l);
  for (int i = 0; i < 3; ++i) {
    V const k = modulo(twelfths + F(i == 0 ? 0 : i == 1 ? 8 : 4), F(12));
    c[i] = l - depth * at_least(at_most(smaller(k - F(3), F(9) - k), F(1)), F(-1));
  }
}

// --- sRGB (IEC 61966-2-1), CIE XYZ, Lab and Luv (CIE 15)
// ----------------------------------------------------------------

template <class V>
KV_HD V decode(V const& x) {
  using F = Scalar<V>;
  V const high = power((at_least(x, F(0.04045)) + F(0.055)) * F(1 / 1.055), F(2.4));
  return select(x > F(0.04045), high, x * F(1 / 12.92));
}
template <class V>
KV_HD V encode(V const& x) {
  using F = Scalar<V>;
  V const high = power(at_least(x, F(0.0031308)), F(1 / 2.4)) * F(1.055) - F(0.055);
  return select(x > F(0.0031308), high, x * F(12.92));
}

template <class V>
KV_HD void clip(V (&c)[3], Scalar<V> wanted) {
  using F = Scalar<V>;
  if (wanted != 0)
    for (int i = 0; i < 3; ++i) c[i] = at_most(at_least(c[i], F(0)), F(1));
}
template <class V>
KV_HD void affine(V (&c)[3], Scalar<V> const* m) {
  V const a = c[0], b = c[1], d = c[2];
  for (int i = 0; i < 3; ++i) c[i] = a * m[3 * i] + b * m[3 * i + 1] + d * m[3 * i + 2] + m[9 + i];
}
template <class V>
KV_HD void linear_to_xyz(V (&c)[3]) {
  using F = Scalar<V>;
  constexpr F m[] = {F(0.412453), F(0.357580), F(0.180423), F(0.212671), F(0.715160), F(0.072169),
                     F(0.019334), F(0.119193), F(0.950227), 0,           0,           0};
  affine(c, m);
}
template <class V>
KV_HD void xyz_to_linear(V (&c)[3]) {
  using F = Scalar<V>;
  constexpr F m[] = {F(3.240481343200526),
                     F(-1.5371515162713183),
                     F(-0.49853632616888777),
                     F(-0.9692549499965681),
                     F(1.8759900014898907),
                     F(0.04155592655829283),
                     F(0.05564663913517714),
                     F(-0.2040413383665112),
                     F(1.0573110696453443),
                     0,
                     0,
                     0};
  affine(c, m);
}

KV_HD constexpr double white(int i) { return i == 0 ? 0.95047 : i == 1 ? 1 : 1.08883; }  // D65
constexpr double kThreshold = 0.008856;

template <class V>
KV_HD void rgb_to_lab(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = decode(c[i]);
  linear_to_xyz(c);
  V f[3];
  for (int i = 0; i < 3; ++i) {
    V const t = c[i] * F(1 / white(i));
    f[i] = select(t > F(kThreshold), power(at_least(t, F(kThreshold)), F(1. / 3)), t * F(7.787) + F(4. / 29));
  }
  c[0] = f[1] * F(116) - F(16);
  c[1] = (f[0] - f[1]) * F(500);
  c[2] = (f[1] - f[2]) * F(200);
}

template <class V>
KV_HD void lab_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const fy = (c[0] + F(16)) * F(1. / 116);
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, at_least(fy - c[2] * F(1. / 200), F(0))};
  for (int i = 0; i < 3; ++i)
    c[i] = select(f[i] > F(0.2068966), f[i] * f[i] * f[i], (f[i] - F(4. / 29)) * F(1 / 7.787)) * F(white(i));
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = encode(c[i]);
}

constexpr double kWhiteU = 4 * 0.95047 / (0.95047 + 15 + 3 * 1.08883), kWhiteV = 9 / (0.95047 + 15 + 3 * 1.08883);

template <class V>
KV_HD void rgb_to_luv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = decode(c[i]);
  linear_to_xyz(c);
  V const y = c[1];
  V const l = select(y > F(kThreshold), power(at_least(y, F(kThreshold)), F(1. / 3)) * F(116) - F(16), y * F(903.3));
  V const total = c[0] + c[1] * F(15) + c[2] * F(3) + eps;
  V const reciprocal = constant<V>(F(1)) / select(total == F(0), constant<V>(F(1)), total);
  V const u = c[0] * F(4) * reciprocal, v = c[1] * F(9) * reciprocal;
  c[0] = l;
  c[1] = l * (u - F(kWhiteU)) * F(13);
  c[2] = l * (v - F(kWhiteV)) * F(13);
}

template <class V>
KV_HD void luv_to_rgb(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  V const l = c[0], root = (l + F(16)) * F(1. / 116);
  V const y = select(l > F(7.999625), root * root * root, l * F(1 / 903.3));
  V const scale = l * F(13) + eps;
  V const reciprocal = constant<V>(F(1)) / select(scale == F(0), constant<V>(F(1)), scale);
  V const a = c[1] * reciprocal + F(kWhiteU), d = c[2] * reciprocal + F(kWhiteV);
  V const y_of_v = y / (d * F(4) + eps);
  c[0] = a * y_of_v * F(9);
  c[1] = y;
  c[2] = (F(12) - a * F(3) - d * F(20)) * y_of_v;
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = encode(c[i]);
}

// --- a program ------------------------------------------------------------------------------------------------------

template <class V>
KV_HD void run_step(Step step, Scalar<V> const* p, V (&c)[3]) {
  switch (step) {
    case Step::affine:
      affine(c, p);
      return clip(c, p[12]);
    case Step::rgb_to_hsv:
      return rgb_to_hsv(c, p[0]);
    case Step::hsv_to_rgb:
      return hsv_to_rgb(c);
    case Step::rgb_to_hls:
      return rgb_to_hls(c, p[0]);
    case Step::hls_to_rgb:
      return hls_to_rgb(c);
    case Step::rgb_to_linear_rgb:
      for (int i = 0; i < 3; ++i) c[i] = decode(c[i]);
      return;
    case Step::linear_rgb_to_rgb:
      for (int i = 0; i < 3; ++i) c[i] = encode(c[i]);
      return;
    case Step::rgb_to_lab:
      return rgb_to_lab(c);
    case Step::lab_to_rgb:
      lab_to_rgb(c);
      return clip(c, p[0]);
    case Step::rgb_to_luv:
      return rgb_to_luv(c, p[0]);
    case Step::luv_to_rgb:
      return luv_to_rgb(c, p[0]);
    case Step::weighted_sum:
      c[0] = c[0] * p[0] + c[1] * p[1] + c[2] * p[2];
      return;
    case Step::count:
      return;
  }
}

// Only: the one step of the program, when it is known while compiling.
template <Step Only, class V, class P>
KV_HD void run_program(P const& program, V (&c)[3]) {
  Scalar<V> const* p = program.parameters;
  if constexpr (Only != Step::count) {
    run_step(Only, p, c);
  } else {
    for (int i = 0; i < program.steps; ++i) {
      run_step(program.step[i], p, c);
      p += parameters_of(program.step[i]);
    }
  }
}

// The gradient of a pixel c from that of its result, of one channel or three: g J.
template <Step Only, class V, class P>
KV_HD void run_program_backward(P const& program, V const (&c)[3], int channels, V (&g)[3]) {
  Dual<V, 3> dual[3];
  for (int i = 0; i < 3; ++i) {
    dual[i].value = c[i];
    for (int k = 0; k < 3; ++k) dual[i].d[k] = V{} + Scalar<V>(i == k);
  }
  run_program<Only>(program, dual);
  V result[3];
  for (int k = 0; k < 3; ++k) {
    result[k] = g[0] * dual[0].d[k];
    if (channels == 3) result[k] = result[k] + g[1] * dual[1].d[k] + g[2] * dual[2].d[k];
  }
  for (int k = 0; k < 3; ++k) g[k] = result[k];
}

}  // namespace kv
