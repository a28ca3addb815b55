// Adjustments of brightness, contrast, saturation, hue and tone, and the luma and HSV of bytes: formulas of color
// steps. Included by steps.h, which says how they are written.
#pragma once

#include "hue.h"
#include "luma.h"

namespace kv::color {

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
// OpenCV's luma of levels, 0 to 255, in fixed point of 15 bits; its floor is a level. Sums stay below 2^24, so that
// float represents them exactly.
template <class V>
KV_HD V luma_of_levels(V const (&levels)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V sum = constant<V>(F(16384));
  for (int i = 0; i < 3; ++i) sum = sum + levels[i] * weights[i];
  return sum * F(1. / 32768);
}
template <class V>
KV_HD void luma_u8_fixed_point(V (&c)[3], Scalar<V> const* weights) {
  using F = Scalar<V>;
  V levels[3];
  for (int i = 0; i < 3; ++i) levels[i] = floor_value(c[i] * F(255) + F(0.5));
  c[0] = floor_value(luma_of_levels(levels, weights)) * F(1. / 255);
}
// OpenCV's HSV of bytes: the hue in 180ths of a turn, and quotients by rounded reciprocals in 4096ths. All numbers are
// integers below 2^24, and no reciprocal ends in a half.
template <class V>
KV_HD void hsv_u8(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = floor_value(c[i] * F(255) + F(0.5));
  V const v = largest(c), range = v - smallest(c);
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
  return c[0] * F(kLumaRed) + c[1] * F(kLumaGreen) + c[2] * F(kLumaBlue);
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
  return select(gray, one, quotient(clamp_min(s.maximum, F(0)), select(gray, one, s.range)));
}
template <class V, class U>
KV_HD void adjust_saturation(V (&c)[3], U const& factor) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const requested = clamp_min(promote<V>(factor), F(0)), limit = saturation_limit(s);
  V const scale = select(limit < requested, limit, requested);
  for (int i = 0; i < 3; ++i) c[i] = s.maximum - (s.maximum - c[i]) * scale;
}
template <class V>
KV_HD void adjust_saturation_vjp(V const (&c)[3], V (&g)[3], Scalar<V> factor) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const requested = constant<V>(factor > F(0) ? factor : F(0)), limit = saturation_limit(s), zero = constant<V>(F(0));
  auto const limited = limit < requested;
  V const scale = select(limited, limit, requested), total = g[0] + g[1] + g[2];
  V weighted = zero;
  for (int i = 0; i < 3; ++i) weighted = weighted - g[i] * (s.maximum - c[i]);
  auto const gray = s.range == F(0);
  // limit is clamp(maximum) / range
  V const grad_clamped = select(limited, quotient(weighted, select(gray, constant<V>(F(1)), s.range)), zero);
  V const grad_range = select(limited, -grad_clamped * limit, zero);
  V const grad_maximum = total - total * scale + select(s.maximum < F(0), zero, grad_clamped) + grad_range;
  for (auto& x : g) x = x * scale;
  channel_range_vjp(c, g, s, grad_maximum, V(-grad_range));
}

template <class V, class G, class U>
KV_HD V blend(V const& x, G const& gray, U const& factor) {
  return clip((x - gray) * factor + gray, true);
}

template <class V>
KV_HD V blend_vjp(V const& x, V const& g, Scalar<V> gray, Scalar<V> factor) {
  return clip_vjp(V((x - gray) * factor + gray), g, true) * factor;
}
// The gradient of `gray` in blend.
template <class V>
KV_HD V blend_vjp_gray(V const& x, V const& g, Scalar<V> gray, Scalar<V> factor) {
  return clip_vjp(V((x - gray) * factor + gray), g, true) * (Scalar<V>(1) - factor);
}

template <class V>
KV_HD V scale_shift_vjp(V const& x, V const& g, Scalar<V> factor, Scalar<V> offset, bool clips) {
  return clip_vjp(V(x * factor + offset), g, clips) * factor;
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
  constexpr F weights[] = {F(kLumaRed), F(kLumaGreen), F(kLumaBlue)};
  for (int i = 0; i < 3; ++i) g[i] = g[i] * factor + of_gray * weights[i];
}

template <class V, class U>
KV_HD void adjust_hue(V (&c)[3], U const& angle) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const sixths = hue_sixths(c, s, hue_offset(c, s, F(0))) + angle * F(6 / kTwoPi);
  hue_to_rgb(c, sixths, s.maximum, s.range);
}
// The gradient of the hue is divided by the range, and that of hue_to_rgb multiplied by it: neither is needed.
template <class V>
KV_HD void adjust_hue_vjp(V const (&c)[3], V (&g)[3], Scalar<V> angle) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const offset = hue_offset(c, s, F(0));
  HueToRgbVjp<V> const vjp(g, V(hue_sixths(c, s, offset) + angle * F(6 / kTwoPi)));
  V const grad_difference = select(s.range == F(0), constant<V>(F(0)), vjp.sixths);
  hue_vjp(c, g, s, grad_difference, offset);
  channel_range_vjp(c, g, s, V(vjp.v + vjp.chroma), V(grad_difference * offset - vjp.chroma));
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

template <class V, class U>
KV_HD V lighten(V const& lightness, U const& limit, U const& factor) {
  using F = Scalar<V>;
  return select(lightness < promote<V>(limit), clamp_max(clamp_min(lightness * factor, F(0)), F(1)), lightness);
}

// The logarithm of positive numbers, denormal ones included.
template <class V>
KV_HD V log2_of_denormal(V const& x) {
  using F = Scalar<V>;
  constexpr F normal = sizeof(F) == 4 ? F(0x1p-126) : F(0x1p-1022), up = sizeof(F) == 4 ? F(0x1p24) : F(0x1p53);
  auto const denormal = x < normal;
  V const y = log2_of(select(denormal, x * up, x));
  return select(denormal, y - F(sizeof(F) == 4 ? 24 : 53), y);
}
// x^exponent, where numbers below 0 count as 0. The slope is at most 2^100, and 0 at 0 for exponents below 1.
template <class V, class U>
KV_HD V power_from_zero(V const& x, U const& exponent) {
  using F = Scalar<V>;
  if constexpr (kIsDual<V>) {
    using Value = decltype(x.value);
    Value e;
    if constexpr (kIsDual<U>)
      e = exponent.value;
    else
      e = promote<Value>(exponent);
    Value const zero = constant<Value>(F(0)), one = constant<Value>(F(1));
    auto const dark = x.value <= F(0);
    Value const log = log2_of_denormal(select(dark, one, x.value));
    Value const slope = select(dark, select((x.value == F(0)) & (e == F(1)), one, zero),
                               exp2_of(clamp_max(Value((e - F(1)) * log), F(100))) * e);
    V y = x;
    y.value = power_from_zero(x.value, e);
    for (auto& d : y.d) d = d * slope;
    if constexpr (kIsDual<U>) {
      Value const by_exponent = select(dark, zero, y.value * log * F(0.69314718055994530942));
      for (int i = 0; i < int(sizeof(y.d) / sizeof(y.d[0])); ++i) y.d[i] = y.d[i] + exponent.d[i] * by_exponent;
    }
    return y;
  } else {
    V const e = promote<V>(exponent), zero = constant<V>(F(0)), one = constant<V>(F(1));
    auto const dark = x <= F(0);  // false for NaN, which stays
    V const black = select(e > F(0), zero, select(e < F(0), constant<V>(F(2)), one));
    return select(dark, black, exp2_of(log2_of_denormal(select(dark, one, x)) * e));
  }
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

}  // namespace kv::color
