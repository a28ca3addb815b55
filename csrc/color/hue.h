// Hue, HSV and HLS: formulas of color steps. Included by steps.h, which says how they are written.
#pragma once

#include "step_math.h"

namespace kv::color {

// The largest and the smallest channel, and the distance between them.
template <class V>
struct ChannelRange {
  V maximum, minimum, range;
  KV_HD explicit ChannelRange(V const (&c)[3]) : maximum(largest(c)), minimum(smallest(c)), range(maximum - minimum) {}
};
// Adds the gradients of the maximum and the minimum to those of the colors.
template <class V>
KV_HD void channel_range_vjp(V const (&c)[3], V (&g)[3], ChannelRange<V> const& s, V const& grad_maximum,
                             V const& grad_minimum) {
  TieWeights<V> const highest(c, s.maximum), lowest(c, s.minimum);
  V const of_highest = grad_maximum * highest.share, of_lowest = grad_minimum * lowest.share;
  for (int i = 0; i < 3; ++i) g[i] = g[i] + of_highest * highest.equal[i] + of_lowest * lowest.equal[i];
}

// Hue in sixths of a turn from the color of the highest channel, in [-1, 1]: the difference of the two others over the
// range. Where channels tie for the highest, red counts before green and green before blue. 0 for grays.
template <class V>
KV_HD V hue_offset(V const (&c)[3], ChannelRange<V> const& s, Scalar<V> eps) {
  using F = Scalar<V>;
  auto const red = s.maximum == c[0], green = s.maximum == c[1];
  V const difference = select(red, c[1] - c[2], select(green, c[2] - c[0], c[0] - c[1]));
  V range = s.range;
  if constexpr (kIsDual<V>) range = select(red, c[0], select(green, c[1], c[2])) - s.minimum;
  return quotient(difference, select(s.range == F(0), constant<V>(F(1)), range + eps));
}
// Hue in sixths of a turn, in (-1, 5]; red is 0.
template <class V>
KV_HD V hue_sixths(V const (&c)[3], ChannelRange<V> const& s, V const& offset) {
  using F = Scalar<V>;
  auto const red = s.maximum == c[0], green = s.maximum == c[1];
  return select(red, offset, select(green, offset + F(2), offset + F(4)));
}
// The gradient of the colors from that of the difference in hue_offset. The hue is smooth where two channels tie for
// the highest, so the gradient of the highest is that of the first of them.
template <class V>
KV_HD void hue_vjp(V const (&c)[3], V (&g)[3], ChannelRange<V> const& s, V const& grad_difference, V const& offset) {
  auto const red = s.maximum == c[0], green = s.maximum == c[1];
  V const grad_highest = -grad_difference * offset;
  g[0] = select(red, grad_highest, select(green, -grad_difference, grad_difference));
  g[1] = select(red, grad_difference, select(green, grad_highest, -grad_difference));
  g[2] = select(red, -grad_difference, select(green, grad_difference, grad_highest));
}

// Hue in radians; 0 for grays.
template <class V>
KV_HD V hue_of(V const (&c)[3], ChannelRange<V> const& s, Scalar<V> eps) {
  using F = Scalar<V>;
  V const sixths = hue_sixths(c, s, hue_offset(c, s, eps)), positive = select(sixths < F(0), sixths + F(6), sixths);
  V const hue = select(positive >= F(6), positive - F(6), positive) * F(kTwoPi / 6);  // may round up to a full turn
  return select(s.range == F(0), constant<V>(F(0)), hue);
}

template <class V>
KV_HD void rgb_to_hsv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const hue = hue_of(c, s, F(0));
  c[1] = quotient(s.range, select(s.maximum == F(0), constant<V>(F(1)), s.maximum + eps));  // not above 1
  c[0] = hue;
  c[2] = s.maximum;
}
template <class V>
KV_HD void rgb_to_hsv_vjp(V const (&c)[3], V (&g)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const zero = constant<V>(F(0)), one = constant<V>(F(1));
  auto const black = s.maximum == F(0), gray = s.range == F(0);
  V const scale = finite_reciprocal(select(black, one, s.maximum + eps)), grad_range = g[1] * scale;
  V const grad_maximum = g[2] + grad_range - select(black, zero, grad_range * s.range * scale);
  V const grad_difference = select(gray, zero, g[0] * F(kTwoPi / 6) * finite_reciprocal(s.range));
  V const offset = hue_offset(c, s, F(0));
  hue_vjp(c, g, s, grad_difference, offset);
  channel_range_vjp(c, g, s, grad_maximum, V(grad_difference * offset - grad_range));
}

// The weights of red, green and blue in a hue, before they are clamped to [0, 1]: 1 and more within a sixth of a turn
// from the channel's hue, 0 and less from two sixths on, linear in between (A. R. Smith's sectors, as one line each).
// `sector` is the hue in sixths of a turn, from 0 to 6.
template <class V>
KV_HD void hue_weights(V (&c)[3], V sector) {
  using F = Scalar<V>;
  c[0] = absolute(sector - F(3)) - F(1);
  c[1] = F(2) - absolute(sector - F(2));
  if constexpr (kIsDual<V>) sector = select(sector == F(0), constant<V>(F(6)) + sector, sector);
  c[2] = F(2) - absolute(sector - F(4));  // the end of its falling at a full turn is that of hue 0
}
template <class V>
KV_HD void hue_to_rgb(V (&c)[3], V const& sixths, V const& v, V const& chroma) {
  using F = Scalar<V>;
  V const sector = modulo(sixths, F(6));
  V minimum = v - chroma;
  if constexpr (!kIsDual<V>) minimum = with_nan_of(sector, minimum);
  hue_weights(c, sector);
  for (auto& x : c) {
    if constexpr (kIsDual<V>)
      x = nan_min(nan_max(x, constant<V>(F(0))), constant<V>(F(1)));
    else
      x = saturate(x);
    x = minimum + chroma * x;
  }
}
// The gradients of the arguments of hue_to_rgb; that of the hue is to be multiplied by the chroma. In a sixth of a turn
// one weight rises or falls, by 1; between two of them the derivative is the mean of both.
template <class V>
struct HueToRgbVjp {
  V sixths, v, chroma;
  KV_HD HueToRgbVjp(V const (&g)[3], V const& hue) : v(g[0] + g[1] + g[2]), chroma(-v) {
    using F = Scalar<V>;
    V const sector = modulo(hue, F(6));
    V part[3];
    hue_weights(part, sector);
    chroma = with_nan_of(sector, chroma);
    for (int i = 0; i < 3; ++i) chroma = chroma + g[i] * saturate(part[i]);
    // Half a turn later the same weights fall that rise here, and the other way round.
    V const half = select(sector < F(3), sector, sector - F(3));
    V const after = select(half < F(1), g[1], select(half < F(2), -g[0], g[2]));
    V const before = select(half > F(2), g[2], select(half > F(1), -g[0], select(half > F(0), g[1], -g[2])));
    sixths = (after + before) * select(sector < F(3), constant<V>(F(0.5)), constant<V>(F(-0.5)));
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
  HueToRgbVjp<V> const vjp(g, c[0] * F(6 / kTwoPi));
  g[0] = vjp.sixths * (c[2] * c[1]) * F(6 / kTwoPi);
  g[1] = vjp.chroma * c[2];
  g[2] = vjp.v + vjp.chroma * c[1];
}

template <class V>
KV_HD void rgb_to_hls(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  ChannelRange<V> const s(c);
  V const sum = s.maximum + s.minimum;
  V const hue = hue_of(c, s, eps), room = nan_min(sum, F(2) - sum);
  c[0] = hue;
  c[1] = sum * F(0.5);
  c[2] = quotient(s.range, select(room == F(0), constant<V>(F(1)), room + eps));
}
template <class V>
KV_HD void hls_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const sixths = c[0] * F(6 / kTwoPi), l = c[1], depth = c[2] * nan_min(l, F(1) - l);
  hue_to_rgb(c, sixths, l + depth, depth * F(2));
}

}  // namespace kv::color
