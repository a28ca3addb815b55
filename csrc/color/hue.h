// Hue, HSV and HLS: formulas of color steps. Included by steps.h, which says how they are written.
#pragma once

#include "step_math.h"

namespace kv::color {

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
  V const minimum = v - chroma;
  hue_weights(c, sixths);
  for (int i = 0; i < 3; ++i) c[i] = minimum + chroma * clamp_to_unit(c[i]);
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
      sixths = sixths + clamp_to_unit_vjp(part[i], derivative);
      chroma = chroma + g[i] * clamp_to_unit(part[i]);
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

}  // namespace kv::color
