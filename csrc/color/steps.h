// What the steps of a colour program do to a pixel c, as formulas on a value type V: a number, Lanes, or Duals of
// either, whose derivatives then are those of the step. Parameters that can be learnt are of a type U: numbers, or V
// where the derivative along one of them is wanted. Included by program_cpu.cpp and program.cuh, which
// bring log2_of, exp2_of and floor_of for numbers and Lanes.
//
// Derivatives stay finite: where a branch is not taken, what it divides by or raises to a power is replaced first.
#pragma once

#include "core/dual.h"
#include "program.h"

namespace kv {

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

// v - chroma max(0, min(k, 4 - k, 1)) with k = 5, 3, 1 sixths of a turn from the hue (A. R. Smith's sectors as one
// line).
template <class V>
KV_HD void color_of(V (&c)[3], V const& hue, V const& v, V const& chroma) {
  using F = Scalar<V>;
  V const sixths = hue * F(6 / kTurn);
  for (int i = 0; i < 3; ++i) {
    V const k = modulo(sixths + F(5 - 2 * i), F(6));
    c[i] = v - chroma * at_least(at_most(smaller(k, F(4) - k), F(1)), F(0));
  }
}
template <class V>
KV_HD void hsv_to_rgb(V (&c)[3]) {
  V const hue = c[0], v = c[2];
  color_of(c, hue, v, v * c[1]);
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

template <int C, class V>
KV_HD void clip(V (&c)[C], bool wanted) {
  using F = Scalar<V>;
  if (wanted)
    for (int i = 0; i < C; ++i) c[i] = at_most(at_least(c[i], F(0)), F(1));
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

// --- adjustments ----------------------------------------------------------------------------------------------------

// A parameter as V.
template <class V, class U>
KV_HD V as(U const& p) {
  if constexpr (__is_same(U, V))
    return p;
  else
    return constant<V>(p);
}

// OpenCV's luma of bytes, in fixed point of 15 bits; no sum reaches 2^24, so float has it exactly.
template <class V>
KV_HD void byte_luma(V (&c)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V sum = constant<V>(F(16384));
  for (int i = 0; i < 3; ++i) sum = sum + minus(V{}, -floor_of(c[i] * F(255) + F(0.5))) * weights[i];
  c[0] = minus(V{}, -floor_of(sum * F(1. / 32768))) * F(1. / 255);
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
template <class V, class U>
KV_HD void adjust_saturation(V (&c)[3], U const& factor) {
  using F = Scalar<V>;
  V const most = larger(larger(c[0], c[1]), c[2]), range = most - smaller(smaller(c[0], c[1]), c[2]);
  auto const grey = range == F(0);
  V const one = constant<V>(F(1)), limit = select(grey, one, at_least(most, F(0)) / select(grey, one, range));
  V const wanted = at_least(as<V>(factor), F(0)), scale = select(limit > wanted, wanted, limit);
  for (int i = 0; i < 3; ++i) c[i] = most - (most - c[i]) * scale;
}

template <class V, class U>
KV_HD void adjust_hue(V (&c)[3], U const& angle) {
  using F = Scalar<V>;
  V const most = larger(larger(c[0], c[1]), c[2]), range = most - smaller(smaller(c[0], c[1]), c[2]);
  V const hue = hue_of(c, most, range, F(0)) + angle;
  color_of(c, hue, most, range);
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

template <int C, class V, class G, class U>
KV_HD void blend(V (&c)[C], G const& grey, U const& factor) {
  for (int i = 0; i < C; ++i) c[i] = (c[i] - grey) * factor + grey;
  clip(c, true);
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
  return constant<V>(F(1)) / (exp2_of(at_most(at_least(bits, F(-100)), F(100))) + F(1));
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
  return select(x == x, minus(V{}, -(floor_of(rounded * (F(1) / step)) * (step / F(255)))), x);
}

// --- a program ------------------------------------------------------------------------------------------------------

// Does a step to all pixels there are: `pixels.each(f)` calls f(c, p, n) for each one, with the step's parameters p,
// one of which may be differentiated, and n, the same as numbers. What chooses between formulas is the same for all
// pixels.
template <class P>
KV_HD void run_step(Step step, P& pixels) {
  constexpr int C = P::kChannels;
#define KV_STEP(name, ...)                                                                                          \
  case Step::name:                                                                                                  \
    return pixels.each([]([[maybe_unused]] auto& c, [[maybe_unused]] auto const* p, [[maybe_unused]] auto const* n) \
                           __attribute__((always_inline)) { __VA_ARGS__; });
#define KV_CHANNELS(formula) \
  for (int i = 0; i < C; ++i) c[i] = formula
  switch (step) {
    KV_STEP(line, KV_CHANNELS(c[i] * p[0] + p[1]); clip(c, n[2] != 0))
    KV_STEP(standardize, KV_CHANNELS((c[i] - p[0]) / p[1]))
    KV_STEP(gamma, KV_CHANNELS(gamma(c[i], p[0], p[1])); clip(c, true))
    KV_STEP(log, KV_CHANNELS(logarithm(c[i], p[0], n[1] != 0)); clip(c, n[2] != 0))
    KV_STEP(sigmoid, KV_CHANNELS(sigmoid(c[i], p[0], p[1], n[2] != 0)))
    KV_STEP(solarize, KV_CHANNELS(solarize(c[i], p[0], p[1], n[2] != 0)))
    KV_STEP(posterize, KV_CHANNELS(posterize(c[i], n[0], n[1])))
    KV_STEP(contrast, blend(c, p[1], p[0]))
    default:
      break;
  }
  if constexpr (C == 3) {
    switch (step) {
      KV_STEP(weighted_sum, c[0] = c[0] * p[0] + c[1] * p[1] + c[2] * p[2])
      KV_STEP(line_rgb, KV_CHANNELS(c[i] * p[i] + p[3 + i]))
      KV_STEP(standardize_rgb, KV_CHANNELS((c[i] - p[i]) / p[3 + i]))
      KV_STEP(saturation, adjust_saturation(c, p[0]))
      KV_STEP(saturation_raw, c[1] = scaled_saturation(c[1], p[0]))
      KV_STEP(saturation_grey, blend(c, luma(c), p[0]))
      KV_STEP(hue, adjust_hue(c, p[0]))
      KV_STEP(hue_raw, c[0] = turned(c[0], p[0]))
      default:
        break;
    }
    if constexpr (!P::kOfParameters) {
      switch (step) {
        KV_STEP(affine, affine(c, n); clip(c, n[12] != 0))
        KV_STEP(rgb_to_hsv, rgb_to_hsv(c, n[0]))
        KV_STEP(hsv_to_rgb, hsv_to_rgb(c))
        KV_STEP(rgb_to_hls, rgb_to_hls(c, n[0]))
        KV_STEP(hls_to_rgb, hls_to_rgb(c))
        KV_STEP(rgb_to_linear_rgb, KV_CHANNELS(decode(c[i])))
        KV_STEP(linear_rgb_to_rgb, KV_CHANNELS(encode(c[i])))
        KV_STEP(rgb_to_lab, rgb_to_lab(c))
        KV_STEP(lab_to_rgb, lab_to_rgb(c); clip(c, n[0] != 0))
        KV_STEP(rgb_to_luv, rgb_to_luv(c, n[0]))
        KV_STEP(luv_to_rgb, luv_to_rgb(c, n[0]))
        KV_STEP(byte_luma, byte_luma(c, n))
        default:
          break;
      }
    }
  }
#undef KV_CHANNELS
#undef KV_STEP
}

}  // namespace kv
