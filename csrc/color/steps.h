// What the steps of a colour program do to a pixel c, as formulas on a value type V: a number, Lanes, or Duals of
// either, whose derivatives then are those of the step. Parameters that can be learnt are of a type U: numbers, or V
// where the derivative along one of them is wanted. Included by program_cpu.cpp and program.cuh, which bring log2_of,
// exp2_of, floor_of, magnitude, reciprocal, and larger and smaller, which are NaN if one of two is, for numbers and
// Lanes.
//
// Derivatives stay finite: where a branch is not taken, what it divides by or raises to a power is replaced first.
//
// The Jacobian of three channels by Duals carries many zeros along. The steps that are used most have what it makes of
// a gradient right below their formula: pull_f(c, g) turns g, of the result of f(c), into that of c.
#pragma once

#include "core/dual.h"
#include "program.h"

namespace kv {

template <class V, int N>
KV_HD Dual<V, N> log2_of(Dual<V, N> a) {
  V const slope = reciprocal(a.value) * Scalar<V>(1.44269504088896340736);
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
template <class V, int N>
KV_HD Dual<V, N> reciprocal(Dual<V, N> a) {
  a.value = reciprocal(a.value);
  V const slope = -a.value * a.value;
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * slope;
  return a;
}
template <class V, int N>
KV_HD Dual<V, N> magnitude(Dual<V, N> const& a) {
  return select(a.value < Scalar<V>(0), -a, a);
}
// The floor as a plain value: its derivative is 0.
template <class V, int N>
KV_HD V floor_of(Dual<V, N> const& a) {
  return floor_of(a.value);
}

template <class V, int N>
KV_HD Dual<V, N> larger(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c = select(b.value <= a.value, a, b);
  c.value = larger(a.value, b.value);
  return c;
}
template <class V, int N>
KV_HD Dual<V, N> smaller(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c = select(b.value >= a.value, a, b);
  c.value = smaller(a.value, b.value);
  return c;
}
// a, which may be NaN, within limits.
template <class V, class F = Scalar<V>>
KV_HD V at_least(V const& a, F low) {
  if constexpr (kIsDual<V>)
    return select(a < low, constant<V>(low), a);
  else
    return larger(a, constant<V>(low));
}
template <class V, class F = Scalar<V>>
KV_HD V at_most(V const& a, F high) {
  if constexpr (kIsDual<V>)
    return select(a > high, constant<V>(high), a);
  else
    return smaller(a, constant<V>(high));
}

// f(x) of one number, with one derivative inside however many x has.
template <class V, class Formula>
KV_HD V of_one(V x, Formula f) {
  if constexpr (kIsDual<V>) {
    using Value = decltype(x.value);
    Dual<Value, 1> const y = with_slope(x.value, f);
    x.value = y.value;
    for (auto& d : x.d) d = d * y.d[0];
    return x;
  } else {
    return f(x);
  }
}
// f(x) and its derivative.
template <class V, class Formula>
KV_HD Dual<V, 1> with_slope(V const& x, Formula f) {
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

constexpr double kTurn = 6.283185307179586476925;

// --- hue -------------------------------------------------------------------------------------------------------------

// The largest channel, and how far it is above the smallest.
template <class V>
struct Span {
  V most, range;
  KV_HD explicit Span(V const (&c)[3])
      : most(larger(larger(c[0], c[1]), c[2])), range(most - smaller(smaller(c[0], c[1]), c[2])) {}
};

// Hue in sixths of a turn, of which red is 0, or less than one sixth less.
template <class V>
KV_HD V sixths_of(V const (&c)[3], Span<V> const& s, Scalar<V> eps) {
  using F = Scalar<V>;
  auto const red = s.most == c[0], green = s.most == c[1];
  V const ahead = select(red, c[1] - c[2], select(green, c[2] - c[0], c[0] - c[1]));
  V const scaled = ahead * reciprocal(select(s.range == F(0), constant<V>(F(1)), s.range + eps));
  return select(red, scaled, select(green, scaled + F(2), scaled + F(4)));
}
// From the gradients of most, range and sixths.
template <class V>
KV_HD void pull_span(V const (&c)[3], V (&g)[3], Span<V> const& s, Scalar<V> eps, V const& of_most, V of_range,
                     V const& of_sixths) {
  using F = Scalar<V>;
  V const none = constant<V>(F(0));
  auto const grey = s.range == F(0), red = s.most == c[0], green = s.most == c[1];
  V const least = smaller(smaller(c[0], c[1]), c[2]);
  V const ahead = select(red, c[1] - c[2], select(green, c[2] - c[0], c[0] - c[1]));
  V const scale = reciprocal(select(grey, constant<V>(F(1)), s.range + eps));
  V const of_ahead = select(grey, none, of_sixths * scale);
  of_range = select(grey, none, of_range - of_ahead * ahead * scale);
  auto const first = least == c[0], second = least == c[1];
  V const above = of_most + of_range;
  g[0] = select(red, above, select(green, -of_ahead, of_ahead)) - select(first, of_range, none);
  g[1] = select(red, of_ahead, select(green, above, -of_ahead)) - select(first, none, select(second, of_range, none));
  g[2] = select(red, -of_ahead, select(green, of_ahead, above)) - select(first, none, select(second, none, of_range));
}

// Hue in radians; 0 for greys.
template <class V>
KV_HD V hue_of(V const (&c)[3], Span<V> const& s, Scalar<V> eps) {
  using F = Scalar<V>;
  V const sixths = sixths_of(c, s, eps), positive = select(sixths < F(0), sixths + F(6), sixths);
  V const hue = select(positive >= F(6), positive - F(6), positive) * F(kTurn / 6);  // what rounds up to a turn
  return select(s.range == F(0), constant<V>(F(0)), hue);
}

template <class V>
KV_HD void rgb_to_hsv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  Span<V> const s(c);
  V const hue = hue_of(c, s, F(0));
  c[1] = s.range / select(s.most == F(0), constant<V>(F(1)), s.most + eps);  // not above 1
  c[0] = hue;
  c[2] = s.most;
}
template <class V>
KV_HD void pull_rgb_to_hsv(V const (&c)[3], V (&g)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  Span<V> const s(c);
  auto const black = s.most == F(0);
  V const scale = reciprocal(select(black, constant<V>(F(1)), s.most + eps)), of_range = g[1] * scale;
  V const of_most = g[2] - select(black, constant<V>(F(0)), of_range * s.range * scale);
  pull_span(c, g, s, F(0), of_most, of_range, V(g[0] * F(kTurn / 6)));
}

// How much of red, green and blue is in a hue: 1 within a sixth of a turn from the channel's own, 0 from two sixths on,
// and linear between (A. R. Smith's sectors as one line each). Here below 0 and above 1, too.
template <class V>
KV_HD void parts_of(V (&c)[3], V const& sixths) {
  using F = Scalar<V>;
  V const turned = modulo(sixths, F(6));
  c[0] = magnitude(turned - F(3)) - F(1);
  c[1] = F(2) - magnitude(turned - F(2));
  c[2] = F(2) - magnitude(turned - F(4));
}
template <class V>
KV_HD void color_of(V (&c)[3], V const& sixths, V const& v, V const& chroma) {
  using F = Scalar<V>;
  V const least = v - chroma;
  parts_of(c, sixths);
  for (int i = 0; i < 3; ++i) c[i] = least + chroma * at_most(at_least(c[i], F(0)), F(1));
}
// The gradients of its arguments, from that of the result.
template <class V>
struct PullColor {
  V sixths, v, chroma;
  KV_HD PullColor(V const (&g)[3], V const& hue, V const& of_chroma) : v(g[0] + g[1] + g[2]), chroma(-v) {
    using F = Scalar<V>;
    V part[3], none = constant<V>(F(0));
    parts_of(part, hue);
    V const turned = modulo(hue, F(6));
    sixths = none;
    constexpr int turns[] = {3, 2, 4};
    for (int i = 0; i < 3; ++i) {
      V const rising = select(turned < F(turns[i]), -g[i], g[i]), slope = i == 0 ? rising : -rising;
      sixths = sixths + select(part[i] < F(0), none, select(part[i] > F(1), none, slope));
      chroma = chroma + g[i] * at_most(at_least(part[i], F(0)), F(1));
    }
    sixths = sixths * of_chroma;
  }
};
template <class V>
KV_HD void hsv_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const sixths = c[0] * F(6 / kTurn), v = c[2];
  color_of(c, sixths, v, v * c[1]);
}
template <class V>
KV_HD void pull_hsv_to_rgb(V const (&c)[3], V (&g)[3]) {
  using F = Scalar<V>;
  PullColor<V> const of(g, c[0] * F(6 / kTurn), c[2] * c[1]);
  g[0] = of.sixths * F(6 / kTurn);
  g[1] = of.chroma * c[2];
  g[2] = of.v + of.chroma * c[1];
}

template <class V>
KV_HD void rgb_to_hls(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  Span<V> const s(c);
  V const sum = s.most + smaller(smaller(c[0], c[1]), c[2]);
  V const hue = hue_of(c, s, eps), room = select(sum < F(1), sum, F(2) - sum);
  c[0] = hue;
  c[1] = sum * F(0.5);
  c[2] = s.range / select(room == F(0), constant<V>(F(1)), room + eps);
}
template <class V>
KV_HD void hls_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const sixths = c[0] * F(6 / kTurn), l = c[1], depth = c[2] * smaller(l, F(1) - l);
  color_of(c, sixths, l + depth, depth * F(2));
}

// --- sRGB (IEC 61966-2-1), CIE XYZ, Lab and Luv (CIE 15) -------------------------------------------------------------

struct Decode {
  template <class V>
  KV_HD V operator()(V const& x) const {
    using F = Scalar<V>;
    V const high = power((at_least(x, F(0.04045)) + F(0.055)) * F(1 / 1.055), F(2.4));
    return select(x > F(0.04045), high, x * F(1 / 12.92));
  }
};
struct Encode {
  template <class V>
  KV_HD V operator()(V const& x) const {
    using F = Scalar<V>;
    V const high = power(at_least(x, F(0.0031308)), F(1 / 2.4)) * F(1.055) - F(0.055);
    return select(x > F(0.0031308), high, x * F(12.92));
  }
};

template <class V>
KV_HD V clip(V const& x, bool wanted) {
  using F = Scalar<V>;
  return wanted ? at_most(at_least(x, F(0)), F(1)) : x;
}
template <class V>
KV_HD void affine(V (&c)[3], Scalar<V> const* m) {
  V const a = c[0], b = c[1], d = c[2];
  for (int i = 0; i < 3; ++i) c[i] = a * m[3 * i] + b * m[3 * i + 1] + d * m[3 * i + 2] + m[9 + i];
}
// The gradient of x from that of clip(x, wanted).
template <class V>
KV_HD V pull_clip(V const& x, V const& g, bool wanted) {
  using F = Scalar<V>;
  V const none = constant<V>(F(0));
  return wanted ? select(x < F(0), none, select(x > F(1), none, g)) : g;
}
template <class V>
KV_HD void pull_linear(V (&g)[3], Scalar<V> const* m) {
  V const a = g[0], b = g[1], d = g[2];
  for (int i = 0; i < 3; ++i) g[i] = a * m[i] + b * m[3 + i] + d * m[6 + i];
}
// m[12] is whether the result is clipped.
template <class V>
KV_HD void pull_affine(V const (&c)[3], V (&g)[3], Scalar<V> const* m) {
  V y[3] = {c[0], c[1], c[2]};
  affine(y, m);
  for (int i = 0; i < 3; ++i) g[i] = pull_clip(y[i], g[i], m[12] != 0);
  pull_linear(g, m);
}

// A linear map of c, or what it makes of a gradient.
template <bool Pulls, class V>
KV_HD void linear(V (&c)[3], Scalar<V> const* m) {
  if constexpr (Pulls)
    pull_linear(c, m);
  else
    affine(c, m);
}
template <bool Pulls = false, class V>
KV_HD void linear_to_xyz(V (&c)[3]) {
  using F = Scalar<V>;
  constexpr F m[] = {F(0.412453), F(0.357580), F(0.180423), F(0.212671), F(0.715160), F(0.072169),
                     F(0.019334), F(0.119193), F(0.950227), 0,           0,           0};
  linear<Pulls>(c, m);
}
template <bool Pulls = false, class V>
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
  linear<Pulls>(c, m);
}

KV_HD constexpr double white(int i) { return i == 0 ? 0.95047 : i == 1 ? 1 : 1.08883; }  // D65
constexpr double kThreshold = 0.008856;
// The cube root of a number that is not small, and of others.
struct Root {
  template <class V>
  KV_HD V operator()(V const& t) const {
    using F = Scalar<V>;
    return select(t > F(kThreshold), power(at_least(t, F(kThreshold)), F(1. / 3)), t * F(7.787) + F(4. / 29));
  }
};
struct Lightness {
  template <class V>
  KV_HD V operator()(V const& y) const {
    using F = Scalar<V>;
    V const high = power(at_least(y, F(kThreshold)), F(1. / 3)) * F(116) - F(16);
    return select(y > F(kThreshold), high, y * F(903.3));
  }
};

template <class V>
KV_HD void rgb_to_lab(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = of_one(c[i], Decode());
  linear_to_xyz(c);
  V f[3];
  for (int i = 0; i < 3; ++i) f[i] = of_one(c[i] * F(1 / white(i)), Root());
  c[0] = f[1] * F(116) - F(16);
  c[1] = (f[0] - f[1]) * F(500);
  c[2] = (f[1] - f[2]) * F(200);
}

template <class V>
KV_HD void pull_rgb_to_lab(V const (&c)[3], V (&g)[3]) {
  using F = Scalar<V>;
  V xyz[3], slope[3];
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const decoded = with_slope(c[i], Decode());
    xyz[i] = decoded.value;
    slope[i] = decoded.d[0];
  }
  linear_to_xyz(xyz);
  V const a = g[1] * F(500), b = g[2] * F(200);
  V const of_root[3] = {a, g[0] * F(116) - a + b, -b};
  for (int i = 0; i < 3; ++i)
    g[i] = of_root[i] * with_slope(V(xyz[i] * F(1 / white(i))), Root()).d[0] * F(1 / white(i));
  linear_to_xyz<true>(g);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * slope[i];
}

// The cube of what Root gives.
struct Cube {
  template <class V>
  KV_HD V operator()(V const& f) const {
    using F = Scalar<V>;
    return select(f > F(0.2068966), f * f * f, (f - F(4. / 29)) * F(1 / 7.787));
  }
};
template <class V>
KV_HD void lab_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const fy = (c[0] + F(16)) * F(1. / 116);
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, at_least(fy - c[2] * F(1. / 200), F(0))};
  for (int i = 0; i < 3; ++i) c[i] = Cube()(f[i]) * F(white(i));
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = of_one(c[i], Encode());
}
template <class V>
KV_HD void pull_lab_to_rgb(V const (&c)[3], V (&g)[3], bool clips) {
  using F = Scalar<V>;
  V const fy = (c[0] + F(16)) * F(1. / 116), fz = fy - c[2] * F(1. / 200);
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, at_least(fz, F(0))};
  V rgb[3], slope[3];
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const cube = with_slope(f[i], Cube());
    rgb[i] = cube.value * F(white(i));
    slope[i] = cube.d[0] * F(white(i));
  }
  xyz_to_linear(rgb);
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const encoded = with_slope(rgb[i], Encode());
    g[i] = pull_clip(encoded.value, V(g[i] * encoded.d[0]), clips);
  }
  xyz_to_linear<true>(g);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * slope[i];
  V const of_fz = select(fz < F(0), constant<V>(F(0)), g[2]);
  V const of_fy = g[0] + g[1] + of_fz;
  g[1] = g[0] * F(1. / 500);
  g[0] = of_fy * F(1. / 116);
  g[2] = of_fz * F(-1. / 200);
}

constexpr double kWhiteU = 4 * 0.95047 / (0.95047 + 15 + 3 * 1.08883), kWhiteV = 9 / (0.95047 + 15 + 3 * 1.08883);

template <class V>
KV_HD void rgb_to_luv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = of_one(c[i], Decode());
  linear_to_xyz(c);
  V const l = of_one(c[1], Lightness());
  V const total = c[0] + c[1] * F(15) + c[2] * F(3) + eps;
  V const scale = reciprocal(select(total == F(0), constant<V>(F(1)), total));
  V const u = c[0] * F(4) * scale, v = c[1] * F(9) * scale;
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
  V const of_l = reciprocal(select(scale == F(0), constant<V>(F(1)), scale));
  V const a = c[1] * of_l + F(kWhiteU), d = c[2] * of_l + F(kWhiteV);
  V const y_of_v = y * reciprocal(d * F(4) + eps);
  c[0] = a * y_of_v * F(9);
  c[1] = y;
  c[2] = (F(12) - a * F(3) - d * F(20)) * y_of_v;
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = of_one(c[i], Encode());
}

// --- adjustments -----------------------------------------------------------------------------------------------------

// A parameter as V.
template <class V, class U>
KV_HD V as(U const& p) {
  if constexpr (__is_same(U, V))
    return p;
  else
    return constant<V>(p);
}

// The floor without derivatives, which bytes have not.
template <class V>
KV_HD V whole(V const& x) {
  return subtract_constant(V{}, -floor_of(x));
}
// OpenCV's luma of bytes, in fixed point of 15 bits; no sum reaches 2^24, so float has it exactly.
template <class V>
KV_HD void byte_luma(V (&c)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V sum = constant<V>(F(16384));
  for (int i = 0; i < 3; ++i) sum = sum + whole(c[i] * F(255) + F(0.5)) * weights[i];
  c[0] = whole(sum * F(1. / 32768)) * F(1. / 255);
}
// OpenCV's HSV of bytes: the hue in 180ths of a turn, and quotients from tables in 4096ths, whose entries are rounded.
// All numbers are whole and less than 2^24; none of the tables' has a fraction of a half.
template <class V>
KV_HD void byte_hsv(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = whole(c[i] * F(255) + F(0.5));
  V const v = larger(larger(c[0], c[1]), c[2]), range = v - smaller(smaller(c[0], c[1]), c[2]);
  V const of_v = whole(reciprocal(at_least(v, F(1))) * F(255 * 4096) + F(0.5));
  V const of_range = whole(reciprocal(at_least(range, F(1))) * F(30 * 4096) + F(0.5));
  V const high = whole(of_v * F(1. / 4096)), low = of_v - high * F(4096);  // their product would have 28 bits
  V const ahead =
      select(v == c[0], c[1] - c[2], select(v == c[1], c[2] - c[0] + range * F(2), c[0] - c[1] + range * F(4)));
  V const hue = whole(ahead * of_range * F(1. / 4096) + F(0.5));
  c[0] = select(hue < F(0), hue + F(180), hue) * F(1. / 255);
  c[1] = (range * high + whole(range * low * F(1. / 4096) + F(0.5))) * F(1. / 255);
  c[2] = v * F(1. / 255);
}
template <class V>
KV_HD void byte_sum(V (&c)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V sum{};
  for (int i = 0; i < 3; ++i) sum = sum + whole(c[i] * F(255) + F(0.5)) * weights[i];
  V const up = whole(sum + F(0.5)), even = whole(up * F(0.5)) * F(2);
  c[0] = select(up - sum == F(0.5), even, up) * F(1. / 255);  // a half goes to the even one of two
}

template <class V>
KV_HD V luma(V const (&c)[3]) {
  using F = Scalar<V>;
  return c[0] * F(0.299) + c[1] * F(0.587) + c[2] * F(0.114);
}
template <class V>
KV_HD V luma(V const (&c)[1]) {
  return c[0];
}

// HSV keeps the largest channel v and measures the others by their distance from it: that of the smallest is s v. To
// scale s is to scale the distances, until the smallest channel reaches 0.
template <class V>
KV_HD V saturation_limit(Span<V> const& s) {
  using F = Scalar<V>;
  auto const grey = s.range == F(0);
  V const one = constant<V>(F(1));
  return select(grey, one, at_least(s.most, F(0)) / select(grey, one, s.range));
}
template <class V, class U>
KV_HD void adjust_saturation(V (&c)[3], U const& factor) {
  using F = Scalar<V>;
  Span<V> const s(c);
  V const wanted = at_least(as<V>(factor), F(0)), limit = saturation_limit(s);
  V const scale = select(limit > wanted, wanted, limit);
  for (int i = 0; i < 3; ++i) c[i] = s.most - (s.most - c[i]) * scale;
}
template <class V>
KV_HD void pull_saturation(V const (&c)[3], V (&g)[3], Scalar<V> factor) {
  using F = Scalar<V>;
  Span<V> const s(c);
  V const wanted = constant<V>(factor > F(0) ? factor : F(0)), limit = saturation_limit(s), none = constant<V>(F(0));
  V const scale = select(limit > wanted, wanted, limit), total = g[0] + g[1] + g[2];
  V of_limit = none, of_span[3];
  for (int i = 0; i < 3; ++i) of_limit = of_limit - g[i] * (s.most - c[i]);
  auto const grey = s.range == F(0);
  V const per_range = reciprocal(select(grey, constant<V>(F(1)), s.range));
  of_limit = select(limit > wanted, none, select(grey, none, of_limit * per_range));
  V const of_most = total - total * scale + select(s.most < F(0), none, of_limit);
  pull_span(c, of_span, s, F(0), of_most, V(-of_limit * limit), none);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * scale + of_span[i];
}

template <class V, class G, class U>
KV_HD V blend(V const& x, G const& grey, U const& factor) {
  return clip((x - grey) * factor + grey, true);
}

// The part of a blend's gradient that the grey gets.
template <class V>
KV_HD V pull_grey(V const& x, V const& g, Scalar<V> grey, Scalar<V> factor) {
  return pull_clip((x - grey) * factor + grey, g, true) * (Scalar<V>(1) - factor);
}

template <class V, class U>
KV_HD void saturation_grey(V (&c)[3], U const& factor) {
  V const grey = luma(c);
  for (auto& x : c) x = blend(x, grey, factor);
}
template <class V>
KV_HD void pull_saturation_grey(V const (&c)[3], V (&g)[3], Scalar<V> factor) {
  using F = Scalar<V>;
  V const grey = luma(c);
  for (int i = 0; i < 3; ++i) g[i] = pull_clip(V((c[i] - grey) * factor + grey), g[i], true);
  V const of_grey = (g[0] + g[1] + g[2]) * (F(1) - factor);
  constexpr F weights[] = {F(0.299), F(0.587), F(0.114)};
  for (int i = 0; i < 3; ++i) g[i] = g[i] * factor + of_grey * weights[i];
}

template <class V, class U>
KV_HD void adjust_hue(V (&c)[3], U const& angle) {
  using F = Scalar<V>;
  Span<V> const s(c);
  V const sixths = sixths_of(c, s, F(0)) + angle * F(6 / kTurn);
  color_of(c, sixths, s.most, s.range);
}
template <class V>
KV_HD void pull_hue(V const (&c)[3], V (&g)[3], Scalar<V> angle) {
  using F = Scalar<V>;
  Span<V> const s(c);
  PullColor<V> const of(g, V(sixths_of(c, s, F(0)) + angle * F(6 / kTurn)), s.range);
  pull_span(c, g, s, F(0), of.v, of.chroma, of.sixths);
}

// Stays in [0, a turn) however it rounds.
template <class V, class U>
KV_HD V turned(V const& hue, U const& angle) {
  using F = Scalar<V>;
  V const rest = modulo(hue + angle, F(kTurn)), positive = select(rest < F(0), rest + F(kTurn), rest);
  return select(positive >= F(kTurn), positive - F(kTurn), positive);
}

template <class V, class U>
KV_HD V scaled_saturation(V const& saturation, U const& factor) {
  using F = Scalar<V>;
  return at_most(at_least(saturation * factor, F(0)), F(1));
}

// The division is the same for all pixels.
template <class V, class U>
KV_HD V standardized(V const& x, U const& mean, U const& deviation) {
  return (x - mean) * reciprocal(deviation);
}

// gain x^exponent. Black has no finite slope below an exponent of 1, so it has none at all; only 0 lifts it.
template <class V, class U>
KV_HD V gamma(V const& x, U const& exponent, U const& gain) {
  using F = Scalar<V>;
  V const e = as<V>(exponent), one = constant<V>(F(1));
  auto const dark = x <= F(0);  // NaN is not, and stays
  V const black = select(e > F(0), constant<V>(F(0)), select(e < F(0), constant<V>(F(2)), one));
  return select(dark, black, exp2_of(log2_of(select(dark, one, x)) * e)) * gain;
}

template <class V, class U>
KV_HD V logarithm(V const& x, U const& gain, bool inverse) {
  using F = Scalar<V>;
  if (inverse) return (exp2_of(x) - F(1)) * gain;
  V const t = x + F(1);
  V const none = select(t == F(0), constant<V>(-F(__builtin_inf())), constant<V>(F(__builtin_nan(""))));
  return select(t > F(0), log2_of(select(t > F(0), t, constant<V>(F(1)))), none) * gain;
}

// Flat from 2^100 on, where the square in its derivative still is a number.
template <class V, class U>
KV_HD V sigmoid(V const& x, U const& cutoff, U const& gain, bool inverse) {
  using F = Scalar<V>;
  V const bits = (x - cutoff) * gain * F(inverse ? 1.44269504088896340736 : -1.44269504088896340736);
  return reciprocal(exp2_of(at_most(at_least(bits, F(-100)), F(100))) + F(1));
}

template <class V, class U>
KV_HD V solarize(V x, U const& threshold, U const& addition, bool adds) {
  using F = Scalar<V>;
  if (adds) x = at_most(at_least(x + addition, F(0)), F(1));
  return select(x < threshold, x, F(1) - x);
}

// The high `bits` bits of the level 255 x, over 255. The product is rounded to the digits of the stored type, so that
// levels over 255 are found again: `split` is 2^n + 1 for a type with n digits less than F (T. J. Dekker, "A
// floating-point technique for extending the available precision", 1971).
template <class V>
KV_HD V posterize(V const& x, Scalar<V> bits, Scalar<V> split) {
  using F = Scalar<V>;
  if (bits >= F(8)) return x;
  F const step = exp2_of(F(8) - (bits > F(0) ? bits : F(0)));
  V const level = at_most(at_least(x, F(0)), F(1)) * F(255);
  V const high = at_least(level * split, F(0)), rounded = high - (high - level);  // at_least: no fused multiply-add
  return select(x == x, subtract_constant(V{}, -(floor_of(rounded * (F(1) / step)) * (step / F(255)))), x);
}

template <class V, class U>
KV_HD V threshold(V const& x, U const& threshold, U const& above, U const& below, bool keeps_above, bool keeps_below) {
  V const high = keeps_above ? x : as<V>(above), low = keeps_below ? x : as<V>(below);
  return select(x > as<V>(threshold), high, low);
}

// --- a program -------------------------------------------------------------------------------------------------------

// Does a step to all pixels there are: `pixels.each(f)` calls f(c, p, n) for each one, with the step's parameters p,
// one of which may be differentiated, and n, the same as numbers. Where channels do not mix, `pixels.each_value(f)`
// calls f(x, i, p, n) for each channel i, with one derivative instead of three. Where a gradient goes back,
// `pixels.each_pulled(f)` calls f(c, g, n). What chooses between formulas is the same for all pixels.
template <class P>
KV_HD void run_step(Step step, P& pixels) {
#define KV_VALUES(name, formula)                                                                 \
  case Step::name:                                                                               \
    return pixels.each_value([](auto& x, [[maybe_unused]] int i, [[maybe_unused]] auto const* p, \
                                [[maybe_unused]] auto const* n) __attribute__((always_inline)) { x = formula; });
#define KV_PIXELS(name, ...)                                                                                        \
  case Step::name:                                                                                                  \
    return pixels.each([]([[maybe_unused]] auto& c, [[maybe_unused]] auto const* p, [[maybe_unused]] auto const* n) \
                           __attribute__((always_inline)) { __VA_ARGS__; });
#define KV_PULLED(name, pull, ...)                                                                                    \
  case Step::name:                                                                                                    \
    if constexpr (P::kPulls)                                                                                          \
      return pixels.each_pulled([]([[maybe_unused]] auto& c, auto& g, [[maybe_unused]] auto const* n)                 \
                                    __attribute__((always_inline)) { pull; });                                        \
    else                                                                                                              \
      return pixels.each([]([[maybe_unused]] auto& c, [[maybe_unused]] auto const* p, [[maybe_unused]] auto const* n) \
                             __attribute__((always_inline)) { __VA_ARGS__; });
  switch (step) {
    KV_VALUES(line, clip(x * p[0] + p[1], n[2] != 0))
    KV_VALUES(standardize, standardized(x, p[0], p[1]))
    KV_VALUES(gamma, clip(gamma(x, p[0], p[1]), true))
    KV_VALUES(log, clip(logarithm(x, p[0], n[1] != 0), n[2] != 0))
    KV_VALUES(sigmoid, sigmoid(x, p[0], p[1], n[2] != 0))
    KV_VALUES(solarize, solarize(x, p[0], p[1], n[2] != 0))
    KV_VALUES(posterize, posterize(x, n[0], n[1]))
    KV_VALUES(contrast, blend(x, p[1], p[0]))
    KV_VALUES(threshold, threshold(x, p[0], p[1], p[2], n[3] != 0, n[4] != 0))
    default:
      break;
  }
  if constexpr (P::kChannels == 3) {
    switch (step) {
      KV_VALUES(line_rgb, clip(x * p[i] + p[3 + i], n[6] != 0))
      KV_VALUES(standardize_rgb, standardized(x, p[i], p[3 + i]))
      KV_PULLED(weighted_sum, auto const above = g[0];
                for (int i = 0; i < 3; ++i) g[i] = above * n[i], c[0] = c[0] * p[0] + c[1] * p[1] + c[2] * p[2])
      KV_PULLED(saturation, pull_saturation(c, g, n[0]), adjust_saturation(c, p[0]))
      KV_PIXELS(saturation_raw, c[1] = scaled_saturation(c[1], p[0]))
      KV_PULLED(saturation_grey, pull_saturation_grey(c, g, n[0]), saturation_grey(c, p[0]))
      KV_PULLED(hue, pull_hue(c, g, n[0]), adjust_hue(c, p[0]))
      KV_PIXELS(hue_raw, c[0] = turned(c[0], p[0]))
      default:
        break;
    }
    if constexpr (!P::kOfParameters) {
      switch (step) {
        KV_VALUES(rgb_to_linear_rgb, Decode()(x))
        KV_VALUES(linear_rgb_to_rgb, Encode()(x))
        KV_PULLED(affine, pull_affine(c, g, n), affine(c, n); for (auto& x : c) x = clip(x, n[12] != 0))
        KV_PULLED(rgb_to_hsv, pull_rgb_to_hsv(c, g, n[0]), rgb_to_hsv(c, n[0]))
        KV_PULLED(hsv_to_rgb, pull_hsv_to_rgb(c, g), hsv_to_rgb(c))
        KV_PIXELS(rgb_to_hls, rgb_to_hls(c, n[0]))
        KV_PIXELS(hls_to_rgb, hls_to_rgb(c))
        KV_PULLED(rgb_to_lab, pull_rgb_to_lab(c, g), rgb_to_lab(c))
        KV_PULLED(lab_to_rgb, pull_lab_to_rgb(c, g, n[0] != 0), lab_to_rgb(c); for (auto& x : c) x = clip(x, n[0] != 0))
        KV_PIXELS(rgb_to_luv, rgb_to_luv(c, n[0]))
        KV_PIXELS(luv_to_rgb, luv_to_rgb(c, n[0]))
        KV_PIXELS(byte_luma, byte_luma(c, n))
        KV_PIXELS(byte_hsv, byte_hsv(c))
        KV_PIXELS(byte_sum, byte_sum(c, n))
        default:
          break;
      }
    }
  }
#undef KV_PULLED
#undef KV_PIXELS
#undef KV_VALUES
}

}  // namespace kv
