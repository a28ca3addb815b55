// The formulas of the steps of color programs, on a pixel c of a value type V: a number, Lanes, or Duals of either,
// whose derivatives are those of the step. Parameters that can be learnt have a type U: a number, or V to differentiate
// along one of them. Included by program_cpu.cpp and program.cuh, which first define, for numbers and Lanes, log2_of,
// exp2_of, floor_of, absolute, reciprocal, and nan_max and nan_min, which return NaN if either argument is NaN.
//
// Derivatives stay finite: in a branch that is not taken, divisors and bases of powers are replaced first.
//
// The Jacobian of three channels by Duals contains many zeros. The steps used most have a vjp right below their
// formula: f_vjp(c, g) turns g, the gradient of the result of f(c), into that of c.
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
template <class V, int N>
KV_HD Dual<V, N> absolute(Dual<V, N> const& a) {
  return select(a.value < Scalar<V>(0), -a, a);
}
// The floor as a plain value, because its derivative is 0.
template <class V, int N>
KV_HD V floor_of(Dual<V, N> const& a) {
  return floor_of(a.value);
}

template <class V, int N>
KV_HD Dual<V, N> nan_max(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c = select(b.value <= a.value, a, b);
  c.value = nan_max(a.value, b.value);
  return c;
}
template <class V, int N>
KV_HD Dual<V, N> nan_min(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c = select(b.value >= a.value, a, b);
  c.value = nan_min(a.value, b.value);
  return c;
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

// --- hue -------------------------------------------------------------------------------------------------------------

// The largest channel, and its distance from the smallest.
template <class V>
struct ChannelRange {
  V maximum, range;
  KV_HD explicit ChannelRange(V const (&c)[3])
      : maximum(nan_max(nan_max(c[0], c[1]), c[2])), range(maximum - nan_min(nan_min(c[0], c[1]), c[2])) {}
};

// Hue in sixths of a turn, in (-1, 5]; red is 0.
template <class V>
KV_HD V hue_sixths(V const (&c)[3], ChannelRange<V> const& s, Scalar<V> eps) {
  using F = Scalar<V>;
  auto const red = s.maximum == c[0], green = s.maximum == c[1];
  V const difference = select(red, c[1] - c[2], select(green, c[2] - c[0], c[0] - c[1]));
  V const scaled = difference * reciprocal(select(s.range == F(0), constant<V>(F(1)), s.range + eps));
  return select(red, scaled, select(green, scaled + F(2), scaled + F(4)));
}
// The gradient of the colors, from those of maximum, range and sixths.
template <class V>
KV_HD void channel_range_vjp(V const (&c)[3], V (&g)[3], ChannelRange<V> const& s, Scalar<V> eps, V const& grad_maximum,
                             V grad_range, V const& grad_sixths) {
  using F = Scalar<V>;
  V const zero = constant<V>(F(0));
  auto const gray = s.range == F(0), red = s.maximum == c[0], green = s.maximum == c[1];
  V const minimum = nan_min(nan_min(c[0], c[1]), c[2]);
  V const difference = select(red, c[1] - c[2], select(green, c[2] - c[0], c[0] - c[1]));
  V const scale = reciprocal(select(gray, constant<V>(F(1)), s.range + eps));
  V const grad_difference = select(gray, zero, grad_sixths * scale);
  grad_range = select(gray, zero, grad_range - grad_difference * difference * scale);
  auto const first = minimum == c[0], second = minimum == c[1];
  V const above = grad_maximum + grad_range;
  g[0] = select(red, above, select(green, -grad_difference, grad_difference)) - select(first, grad_range, zero);
  g[1] = select(red, grad_difference, select(green, above, -grad_difference)) -
         select(first, zero, select(second, grad_range, zero));
  g[2] = select(red, -grad_difference, select(green, grad_difference, above)) -
         select(first, zero, select(second, zero, grad_range));
}

// Hue in radians; 0 for grays.
template <class V>
KV_HD V hue_of(V const (&c)[3], ChannelRange<V> const& s, Scalar<V> eps) {
  using F = Scalar<V>;
  V const sixths = hue_sixths(c, s, eps), positive = select(sixths < F(0), sixths + F(6), sixths);
  V const hue = select(positive >= F(6), positive - F(6), positive) * F(kTwoPi / 6);  // may round up to a full turn
  return select(s.range == F(0), constant<V>(F(0)), hue);
}

template <class V>
KV_HD void rgb_to_hsv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const hue = hue_of(c, s, F(0));
  c[1] = s.range / select(s.maximum == F(0), constant<V>(F(1)), s.maximum + eps);  // not above 1
  c[0] = hue;
  c[2] = s.maximum;
}
template <class V>
KV_HD void rgb_to_hsv_vjp(V const (&c)[3], V (&g)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  auto const black = s.maximum == F(0);
  V const scale = reciprocal(select(black, constant<V>(F(1)), s.maximum + eps)), grad_range = g[1] * scale;
  V const grad_maximum = g[2] - select(black, constant<V>(F(0)), grad_range * s.range * scale);
  channel_range_vjp(c, g, s, F(0), grad_maximum, grad_range, V(g[0] * F(kTwoPi / 6)));
}

// The weights of red, green and blue in a hue, before they are clamped to [0, 1]: 1 and more within a sixth of a turn
// from the channel's hue, 0 and less from two sixths on, linear in between (A. R. Smith's sectors, as one line each).
template <class V>
KV_HD void hue_weights(V (&c)[3], V const& sixths) {
  using F = Scalar<V>;
  V const sector = modulo(sixths, F(6));
  c[0] = absolute(sector - F(3)) - F(1);
  c[1] = F(2) - absolute(sector - F(2));
  c[2] = F(2) - absolute(sector - F(4));
}
template <class V>
KV_HD void hue_to_rgb(V (&c)[3], V const& sixths, V const& v, V const& chroma) {
  using F = Scalar<V>;
  V const minimum = v - chroma;
  hue_weights(c, sixths);
  for (int i = 0; i < 3; ++i) c[i] = minimum + chroma * clamp_max(clamp_min(c[i], F(0)), F(1));
}
// The gradients of the arguments of hue_to_rgb.
template <class V>
struct HueToRgbVjp {
  V sixths, v, chroma;
  KV_HD HueToRgbVjp(V const (&g)[3], V const& hue, V const& chroma_value) : v(g[0] + g[1] + g[2]), chroma(-v) {
    using F = Scalar<V>;
    V part[3], zero = constant<V>(F(0));
    hue_weights(part, hue);
    V const sector = modulo(hue, F(6));
    sixths = zero;
    constexpr int vertices[] = {3, 2, 4};
    for (int i = 0; i < 3; ++i) {
      V const rising = select(sector < F(vertices[i]), -g[i], g[i]), derivative = i == 0 ? rising : -rising;
      sixths = sixths + select(part[i] < F(0), zero, select(part[i] > F(1), zero, derivative));
      chroma = chroma + g[i] * clamp_max(clamp_min(part[i], F(0)), F(1));
    }
    sixths = sixths * chroma_value;
  }
};
template <class V>
KV_HD void hsv_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const sixths = c[0] * F(6 / kTwoPi), v = c[2];
  hue_to_rgb(c, sixths, v, v * c[1]);
}
template <class V>
KV_HD void hsv_to_rgb_vjp(V const (&c)[3], V (&g)[3]) {
  using F = Scalar<V>;
  HueToRgbVjp<V> const vjp(g, c[0] * F(6 / kTwoPi), c[2] * c[1]);
  g[0] = vjp.sixths * F(6 / kTwoPi);
  g[1] = vjp.chroma * c[2];
  g[2] = vjp.v + vjp.chroma * c[1];
}

template <class V>
KV_HD void rgb_to_hls(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const sum = s.maximum + nan_min(nan_min(c[0], c[1]), c[2]);
  V const hue = hue_of(c, s, eps), room = select(sum < F(1), sum, F(2) - sum);
  c[0] = hue;
  c[1] = sum * F(0.5);
  c[2] = s.range / select(room == F(0), constant<V>(F(1)), room + eps);
}
template <class V>
KV_HD void hls_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const sixths = c[0] * F(6 / kTwoPi), l = c[1], depth = c[2] * nan_min(l, F(1) - l);
  hue_to_rgb(c, sixths, l + depth, depth * F(2));
}

// --- sRGB (IEC 61966-2-1), CIE XYZ, Lab and Luv (CIE 15) -------------------------------------------------------------

struct SrgbToLinear {
  template <class V>
  KV_HD V operator()(V const& x) const {
    using F = Scalar<V>;
    V const high = power((clamp_min(x, F(0.04045)) + F(0.055)) * F(1 / 1.055), F(2.4));
    return select(x > F(0.04045), high, x * F(1 / 12.92));
  }
};
struct LinearToSrgb {
  template <class V>
  KV_HD V operator()(V const& x) const {
    using F = Scalar<V>;
    V const high = power(clamp_min(x, F(0.0031308)), F(1 / 2.4)) * F(1.055) - F(0.055);
    return select(x > F(0.0031308), high, x * F(12.92));
  }
};

template <class V>
KV_HD V clip(V const& x, bool enabled) {
  using F = Scalar<V>;
  return enabled ? clamp_max(clamp_min(x, F(0)), F(1)) : x;
}
template <class V>
KV_HD void affine(V (&c)[3], Scalar<V> const* m) {
  V const a = c[0], b = c[1], d = c[2];
  for (int i = 0; i < 3; ++i) c[i] = a * m[3 * i] + b * m[3 * i + 1] + d * m[3 * i + 2] + m[9 + i];
}
// The gradient of x from that of clip(x, enabled).
template <class V>
KV_HD V clip_vjp(V const& x, V const& g, bool enabled) {
  using F = Scalar<V>;
  V const zero = constant<V>(F(0));
  return enabled ? select(x < F(0), zero, select(x > F(1), zero, g)) : g;
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

// A linear map of c, or its vjp.
template <bool Vjp, class V>
KV_HD void linear(V (&c)[3], Scalar<V> const* m) {
  if constexpr (Vjp)
    linear_vjp(c, m);
  else
    affine(c, m);
}
template <bool Vjp = false, class V>
KV_HD void linear_to_xyz(V (&c)[3]) {
  using F = Scalar<V>;
  constexpr F m[] = {F(0.412453), F(0.357580), F(0.180423), F(0.212671), F(0.715160), F(0.072169),
                     F(0.019334), F(0.119193), F(0.950227), 0,           0,           0};
  linear<Vjp>(c, m);
}
template <bool Vjp = false, class V>
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
  linear<Vjp>(c, m);
}

KV_HD constexpr double white_point(int i) { return i == 0 ? 0.95047 : i == 1 ? 1 : 1.08883; }  // D65
constexpr double kLabThreshold = 0.008856;
// CIE's f(t): the cube root, and a line for small t.
struct LabRoot {
  template <class V>
  KV_HD V operator()(V const& t) const {
    using F = Scalar<V>;
    return select(t > F(kLabThreshold), power(clamp_min(t, F(kLabThreshold)), F(1. / 3)), t * F(7.787) + F(4. / 29));
  }
};
struct Lightness {
  template <class V>
  KV_HD V operator()(V const& y) const {
    using F = Scalar<V>;
    V const high = power(clamp_min(y, F(kLabThreshold)), F(1. / 3)) * F(116) - F(16);
    return select(y > F(kLabThreshold), high, y * F(903.3));
  }
};

template <class V>
KV_HD void rgb_to_lab(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], SrgbToLinear());
  linear_to_xyz(c);
  V f[3];
  for (int i = 0; i < 3; ++i) f[i] = map_scalar(c[i] * F(1 / white_point(i)), LabRoot());
  c[0] = f[1] * F(116) - F(16);
  c[1] = (f[0] - f[1]) * F(500);
  c[2] = (f[1] - f[2]) * F(200);
}

template <class V>
KV_HD void rgb_to_lab_vjp(V const (&c)[3], V (&g)[3]) {
  using F = Scalar<V>;
  V xyz[3], derivative[3];
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const decoded = with_derivative(c[i], SrgbToLinear());
    xyz[i] = decoded.value;
    derivative[i] = decoded.d[0];
  }
  linear_to_xyz(xyz);
  V const a = g[1] * F(500), b = g[2] * F(200);
  V const grad_roots[3] = {a, g[0] * F(116) - a + b, -b};
  for (int i = 0; i < 3; ++i)
    g[i] = grad_roots[i] * with_derivative(V(xyz[i] * F(1 / white_point(i))), LabRoot()).d[0] * F(1 / white_point(i));
  linear_to_xyz<true>(g);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * derivative[i];
}

// The inverse of LabRoot.
struct LabCube {
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
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, clamp_min(fy - c[2] * F(1. / 200), F(0))};
  for (int i = 0; i < 3; ++i) c[i] = LabCube()(f[i]) * F(white_point(i));
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], LinearToSrgb());
}
template <class V>
KV_HD void lab_to_rgb_vjp(V const (&c)[3], V (&g)[3], bool clips) {
  using F = Scalar<V>;
  V const fy = (c[0] + F(16)) * F(1. / 116), fz = fy - c[2] * F(1. / 200);
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, clamp_min(fz, F(0))};
  V rgb[3], derivative[3];
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const cube = with_derivative(f[i], LabCube());
    rgb[i] = cube.value * F(white_point(i));
    derivative[i] = cube.d[0] * F(white_point(i));
  }
  xyz_to_linear(rgb);
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const encoded = with_derivative(rgb[i], LinearToSrgb());
    g[i] = clip_vjp(encoded.value, V(g[i] * encoded.d[0]), clips);
  }
  xyz_to_linear<true>(g);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * derivative[i];
  V const grad_fz = select(fz < F(0), constant<V>(F(0)), g[2]);
  V const grad_fy = g[0] + g[1] + grad_fz;
  g[1] = g[0] * F(1. / 500);
  g[0] = grad_fy * F(1. / 116);
  g[2] = grad_fz * F(-1. / 200);
}

constexpr double kWhiteU = 4 * 0.95047 / (0.95047 + 15 + 3 * 1.08883), kWhiteV = 9 / (0.95047 + 15 + 3 * 1.08883);

template <class V>
KV_HD void rgb_to_luv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], SrgbToLinear());
  linear_to_xyz(c);
  V const l = map_scalar(c[1], Lightness());
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
  V const inverse_l = reciprocal(select(scale == F(0), constant<V>(F(1)), scale));
  V const a = c[1] * inverse_l + F(kWhiteU), d = c[2] * inverse_l + F(kWhiteV);
  V const y_per_v = y * reciprocal(d * F(4) + eps);
  c[0] = a * y_per_v * F(9);
  c[1] = y;
  c[2] = (F(12) - a * F(3) - d * F(20)) * y_per_v;
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], LinearToSrgb());
}

// --- adjustments -----------------------------------------------------------------------------------------------------

// The parameter as a V.
template <class V, class U>
KV_HD V promote(U const& p) {
  if constexpr (__is_same(U, V))
    return p;
  else
    return constant<V>(p);
}

// The floor, without derivatives: bytes have none.
template <class V>
KV_HD V floor_value(V const& x) {
  return subtract_constant(V{}, -floor_of(x));
}
// OpenCV's luma of bytes in fixed point of 15 bits. Sums stay below 2^24, so that float represents them exactly.
template <class V>
KV_HD void luma_u8_fixed_point(V (&c)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V sum = constant<V>(F(16384));
  for (int i = 0; i < 3; ++i) sum = sum + floor_value(c[i] * F(255) + F(0.5)) * weights[i];
  c[0] = floor_value(sum * F(1. / 32768)) * F(1. / 255);
}
// OpenCV's HSV of bytes: the hue in 180ths of a turn, and quotients by rounded reciprocals in 4096ths. All numbers are
// integers below 2^24, and no reciprocal ends in a half.
template <class V>
KV_HD void hsv_u8(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = floor_value(c[i] * F(255) + F(0.5));
  V const v = nan_max(nan_max(c[0], c[1]), c[2]), range = v - nan_min(nan_min(c[0], c[1]), c[2]);
  V const inverse_v = floor_value(reciprocal(clamp_min(v, F(1))) * F(255 * 4096) + F(0.5));
  V const inverse_range = floor_value(reciprocal(clamp_min(range, F(1))) * F(30 * 4096) + F(0.5));
  V const high = floor_value(inverse_v * F(1. / 4096)),
          low = inverse_v - high * F(4096);  // their product would have 28 bits
  V const difference =
      select(v == c[0], c[1] - c[2], select(v == c[1], c[2] - c[0] + range * F(2), c[0] - c[1] + range * F(4)));
  V const hue = floor_value(difference * inverse_range * F(1. / 4096) + F(0.5));
  c[0] = select(hue < F(0), hue + F(180), hue) * F(1. / 255);
  c[1] = (range * high + floor_value(range * low * F(1. / 4096) + F(0.5))) * F(1. / 255);
  c[2] = v * F(1. / 255);
}
template <class V>
KV_HD void luma_u8(V (&c)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V sum{};
  for (int i = 0; i < 3; ++i) sum = sum + floor_value(c[i] * F(255) + F(0.5)) * weights[i];
  V const up = floor_value(sum + F(0.5)), even = floor_value(up * F(0.5)) * F(2);
  c[0] = select(up - sum == F(0.5), even, up) * F(1. / 255);  // rounds half to even
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

// HSV keeps the largest channel v; the smallest one is at a distance of s v from it. Scaling s scales all distances
// from v, until the smallest channel reaches 0.
template <class V>
KV_HD V saturation_limit(ChannelRange<V> const& s) {
  using F = Scalar<V>;
  auto const gray = s.range == F(0);
  V const one = constant<V>(F(1));
  return select(gray, one, clamp_min(s.maximum, F(0)) / select(gray, one, s.range));
}
template <class V, class U>
KV_HD void adjust_saturation(V (&c)[3], U const& factor) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const requested = clamp_min(promote<V>(factor), F(0)), limit = saturation_limit(s);
  V const scale = select(limit > requested, requested, limit);
  for (int i = 0; i < 3; ++i) c[i] = s.maximum - (s.maximum - c[i]) * scale;
}
template <class V>
KV_HD void adjust_saturation_vjp(V const (&c)[3], V (&g)[3], Scalar<V> factor) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const requested = constant<V>(factor > F(0) ? factor : F(0)), limit = saturation_limit(s), zero = constant<V>(F(0));
  V const scale = select(limit > requested, requested, limit), total = g[0] + g[1] + g[2];
  V grad_limit = zero, grad_colors[3];
  for (int i = 0; i < 3; ++i) grad_limit = grad_limit - g[i] * (s.maximum - c[i]);
  auto const gray = s.range == F(0);
  V const inverse_range = reciprocal(select(gray, constant<V>(F(1)), s.range));
  grad_limit = select(limit > requested, zero, select(gray, zero, grad_limit * inverse_range));
  V const grad_maximum = total - total * scale + select(s.maximum < F(0), zero, grad_limit);
  channel_range_vjp(c, grad_colors, s, F(0), grad_maximum, V(-grad_limit * limit), zero);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * scale + grad_colors[i];
}

template <class V, class G, class U>
KV_HD V blend(V const& x, G const& gray, U const& factor) {
  return clip((x - gray) * factor + gray, true);
}

// The gradient of `gray` in blend.
template <class V>
KV_HD V blend_vjp_gray(V const& x, V const& g, Scalar<V> gray, Scalar<V> factor) {
  return clip_vjp((x - gray) * factor + gray, g, true) * (Scalar<V>(1) - factor);
}

template <class V, class U>
KV_HD void saturation_gray(V (&c)[3], U const& factor) {
  V const gray = luma(c);
  for (auto& x : c) x = blend(x, gray, factor);
}
template <class V>
KV_HD void saturation_gray_vjp(V const (&c)[3], V (&g)[3], Scalar<V> factor) {
  using F = Scalar<V>;
  V const gray = luma(c);
  for (int i = 0; i < 3; ++i) g[i] = clip_vjp(V((c[i] - gray) * factor + gray), g[i], true);
  V const of_gray = (g[0] + g[1] + g[2]) * (F(1) - factor);
  constexpr F weights[] = {F(0.299), F(0.587), F(0.114)};
  for (int i = 0; i < 3; ++i) g[i] = g[i] * factor + of_gray * weights[i];
}

template <class V, class U>
KV_HD void adjust_hue(V (&c)[3], U const& angle) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const sixths = hue_sixths(c, s, F(0)) + angle * F(6 / kTwoPi);
  hue_to_rgb(c, sixths, s.maximum, s.range);
}
template <class V>
KV_HD void adjust_hue_vjp(V const (&c)[3], V (&g)[3], Scalar<V> angle) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  HueToRgbVjp<V> const vjp(g, V(hue_sixths(c, s, F(0)) + angle * F(6 / kTwoPi)), s.range);
  channel_range_vjp(c, g, s, F(0), vjp.v, vjp.chroma, vjp.sixths);
}

// In [0, 2 pi), also after rounding.
template <class V, class U>
KV_HD V rotate_hue(V const& hue, U const& angle) {
  using F = Scalar<V>;
  V const rest = modulo(hue + angle, F(kTwoPi)), positive = select(rest < F(0), rest + F(kTwoPi), rest);
  return select(positive >= F(kTwoPi), positive - F(kTwoPi), positive);
}

template <class V, class U>
KV_HD V scale_saturation(V const& saturation, U const& factor) {
  using F = Scalar<V>;
  return clamp_max(clamp_min(saturation * factor, F(0)), F(1));
}

// The reciprocal is the same for all pixels, so it is hoisted out of their loop.
template <class V, class U>
KV_HD V standardize(V const& x, U const& mean, U const& deviation) {
  return (x - mean) * reciprocal(deviation);
}

// gain x^exponent. Black has no finite derivative for exponents below 1, so its derivative is 0. It stays black unless
// the exponent is 0.
template <class V, class U>
KV_HD V gamma(V const& x, U const& exponent, U const& gain) {
  using F = Scalar<V>;
  V const e = promote<V>(exponent), one = constant<V>(F(1));
  auto const dark = x <= F(0);  // false for NaN, which stays
  V const black = select(e > F(0), constant<V>(F(0)), select(e < F(0), constant<V>(F(2)), one));
  return select(dark, black, exp2_of(log2_of(select(dark, one, x)) * e)) * gain;
}

template <class V, class U>
KV_HD V logarithm(V const& x, U const& gain, bool inverse) {
  using F = Scalar<V>;
  if (inverse) return (exp2_of(x) - F(1)) * gain;
  V const t = x + F(1);
  V const zero = select(t == F(0), constant<V>(-F(__builtin_inf())), constant<V>(F(__builtin_nan(""))));
  return select(t > F(0), log2_of(select(t > F(0), t, constant<V>(F(1)))), zero) * gain;
}

// Constant beyond 2^100, so that the square in its derivative stays finite.
template <class V, class U>
KV_HD V sigmoid(V const& x, U const& cutoff, U const& gain, bool inverse) {
  using F = Scalar<V>;
  V const bits = (x - cutoff) * gain * F(inverse ? 1.44269504088896340736 : -1.44269504088896340736);
  return reciprocal(exp2_of(clamp_max(clamp_min(bits, F(-100)), F(100))) + F(1));
}

template <class V, class U>
KV_HD V solarize(V x, U const& threshold, U const& addition, bool adds) {
  using F = Scalar<V>;
  if (adds) x = clamp_max(clamp_min(x + addition, F(0)), F(1));
  return select(x < threshold, x, F(1) - x);
}

// The high `bits` bits of the level 255 x, over 255. The product is rounded to the digits of the stored type, so that a
// level over 255 gives that level again: `split` is 2^n + 1 for a type with n digits less than F (T. J. Dekker, "A
// floating-point technique for extending the available precision", 1971).
template <class V>
KV_HD V posterize(V const& x, Scalar<V> bits, Scalar<V> split) {
  using F = Scalar<V>;
  if (bits >= F(8)) return x;
  F const step = exp2_of(F(8) - (bits > F(0) ? bits : F(0)));
  V const level = clamp_max(clamp_min(x, F(0)), F(1)) * F(255);
  V const high = clamp_min(level * split, F(0)), rounded = high - (high - level);  // clamp_min: no fused multiply-add
  return select(x == x, subtract_constant(V{}, -(floor_of(rounded * (F(1) / step)) * (step / F(255)))), x);
}

template <class V, class U>
KV_HD V threshold(V const& x, U const& threshold, U const& above, U const& below, bool keeps_above, bool keeps_below) {
  V const high = keeps_above ? x : promote<V>(above), low = keeps_below ? x : promote<V>(below);
  return select(x > promote<V>(threshold), high, low);
}

// --- a program -------------------------------------------------------------------------------------------------------

// Applies a step to all pixels. `pixels.each(f)` calls f(c, p, n) for each pixel, with the step's parameters p, which
// may carry a derivative, and n, the same parameters as numbers. For steps that do not mix channels
// `pixels.each_value(f)` calls f(x, i, p, n) for each channel i, with one derivative instead of three. For steps with a
// vjp `pixels.each_vjp(f)` calls f(c, g, n). Branches between formulas are the same for all pixels. Every step of
// step_list.h has its case here.
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
#define KV_PIXELS_VJP(name, vjp, ...)                                                                                 \
  case Step::name:                                                                                                    \
    if constexpr (P::kInputGradient)                                                                                  \
      return pixels.each_vjp([]([[maybe_unused]] auto& c, auto& g, [[maybe_unused]] auto const* n)                    \
                                 __attribute__((always_inline)) { vjp; });                                            \
    else                                                                                                              \
      return pixels.each([]([[maybe_unused]] auto& c, [[maybe_unused]] auto const* p, [[maybe_unused]] auto const* n) \
                             __attribute__((always_inline)) { __VA_ARGS__; });
  switch (step) {
    KV_VALUES(scale_shift, clip(x * p[0] + p[1], n[2] != 0))
    KV_VALUES(standardize, standardize(x, p[0], p[1]))
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
      KV_VALUES(scale_shift_rgb, clip(x * p[i] + p[3 + i], n[6] != 0))
      KV_VALUES(standardize_rgb, standardize(x, p[i], p[3 + i]))
      KV_PIXELS_VJP(weighted_sum, auto const grad_sum = g[0];
                    for (int i = 0; i < 3; ++i) g[i] = grad_sum * n[i], c[0] = c[0] * p[0] + c[1] * p[1] + c[2] * p[2])
      KV_PIXELS_VJP(saturation, adjust_saturation_vjp(c, g, n[0]), adjust_saturation(c, p[0]))
      KV_PIXELS(saturation_raw, c[1] = scale_saturation(c[1], p[0]))
      KV_PIXELS_VJP(saturation_gray, saturation_gray_vjp(c, g, n[0]), saturation_gray(c, p[0]))
      KV_PIXELS_VJP(hue, adjust_hue_vjp(c, g, n[0]), adjust_hue(c, p[0]))
      KV_PIXELS(hue_raw, c[0] = rotate_hue(c[0], p[0]))
      default:
        break;
    }
    if constexpr (!P::kParameterGradient) {
      switch (step) {
        KV_VALUES(rgb_to_linear_rgb, SrgbToLinear()(x))
        KV_VALUES(linear_rgb_to_rgb, LinearToSrgb()(x))
        KV_PIXELS_VJP(affine, affine_vjp(c, g, n), affine(c, n); for (auto& x : c) x = clip(x, n[12] != 0))
        KV_PIXELS_VJP(rgb_to_hsv, rgb_to_hsv_vjp(c, g, n[0]), rgb_to_hsv(c, n[0]))
        KV_PIXELS_VJP(hsv_to_rgb, hsv_to_rgb_vjp(c, g), hsv_to_rgb(c))
        KV_PIXELS(rgb_to_hls, rgb_to_hls(c, n[0]))
        KV_PIXELS(hls_to_rgb, hls_to_rgb(c))
        KV_PIXELS_VJP(rgb_to_lab, rgb_to_lab_vjp(c, g), rgb_to_lab(c))
        KV_PIXELS_VJP(lab_to_rgb, lab_to_rgb_vjp(c, g, n[0] != 0), lab_to_rgb(c);
                      for (auto& x : c) x = clip(x, n[0] != 0))
        KV_PIXELS(rgb_to_luv, rgb_to_luv(c, n[0]))
        KV_PIXELS(luv_to_rgb, luv_to_rgb(c, n[0]))
        KV_PIXELS(luma_u8_fixed_point, luma_u8_fixed_point(c, n))
        KV_PIXELS(hsv_u8, hsv_u8(c))
        KV_PIXELS(luma_u8, luma_u8(c, n))
        default:
          break;
      }
    }
  }
#undef KV_PIXELS_VJP
#undef KV_PIXELS
#undef KV_VALUES
}

}  // namespace kv::color
