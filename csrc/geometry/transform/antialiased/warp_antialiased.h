// Antialiased sampling: the weighted mean of the source pixels that a pixel of the output covers. This file defines it
// for warps and maps, CPU and CUDA, values and gradients; docs/conventions.md has it in words.
//
//   J        the derivative of the sampling coordinates (u, v) by the pixel's (x, y)
//   S        the factor of J = S R that is symmetric, without the rotation R: its eigenvalues are the source pixels
//            per pixel of the output along two orthogonal axes, here clamped to [1, kMaxShrink]
//   weight   tri(q_x) tri(q_y) with q = S^-1 (pixel - (u, v)) and tri(q) = max(0, 1 - |q|), divided by the sum of all
//
// Where nothing shrinks S is the identity, and the taps and weights are those of bilinear sampling. Where axes stay
// axes they are those of an antialiased bilinear resize. Taps out of bounds follow the padding, as those of sampling.h.
#pragma once

#include "geometry/transform/sampling.h"

namespace kv::geometry {

constexpr int kMaxShrink = 32;     // source pixels to one; beyond it pixels are skipped
constexpr int kMaxReach = 48;      // above kMaxShrink * sqrt(2), how far taps are from the center along an axis
constexpr double kMaxSlope = 1e4;  // what derivatives are clamped to, so that their products fit a float

// The derivatives of u and v by x and y.
template <class F>
struct Jacobian {
  F ux, uy, vx, vy;
};

template <class F>
KV_HD F magnitude(F x) {
  return x < 0 ? -x : x;
}

// Of a map from pixels of the output at (x, y), which it takes to (u, v).
template <class F>
KV_HD Jacobian<F> jacobian(Homography<F> const& h, F x, F y, F u, F v) {
  F const* const m = h.m;
  if (h.affine) return {m[0], m[1], m[3], m[4]};
  F const scale = 1 / h.weight(x, y);
  return {(m[0] - u * m[6]) * scale, (m[1] - u * m[7]) * scale, (m[3] - v * m[6]) * scale, (m[4] - v * m[7]) * scale};
}
// Adds the gradients by the entries of the map to nine sums.
template <class F, class Sum>
KV_HD void jacobian_vjp(Homography<F> const& h, F weight, F x, F y, F u, F v, Jacobian<F> const& j, F gu, F gv,
                        Jacobian<F> const& g, Sum* sums) {
  F const scale = 1 / weight, m6 = h.m[6], m7 = h.m[7];
  F const by_m6 = -(g.ux * u + g.vx * v) * scale, by_m7 = -(g.uy * u + g.vy * v) * scale;
  gu -= (g.ux * m6 + g.uy * m7) * scale;
  gv -= (g.vx * m6 + g.vy * m7) * scale;
  F const by_weight = -(gu * u + gv * v + g.ux * j.ux + g.uy * j.uy + g.vx * j.vx + g.vy * j.vy) * scale;
  F const by_u = gu * scale, by_v = gv * scale;
  F const all[] = {by_u * x + g.ux * scale, by_u * y + g.uy * scale, by_u,
                   by_v * x + g.vx * scale, by_v * y + g.vy * scale, by_v,
                   by_weight * x + by_m6,   by_weight * y + by_m7,   by_weight};
  F rest = 0;  // coordinates at infinity have no gradient
  for (F s : all) rest += s - s;
  if (rest == 0)
    for (int i = 0; i < 9; ++i) sums[i] += Sum(all[i]);
}

// Of maps, by the differences of neighbors: central ones inside, 0 along an axis of one pixel.
template <class F>
KV_HD Jacobian<F> jacobian(SampleCoords<F> const& coords, int64_t b, int64_t y, int64_t x) {
  int64_t const left = max(x - 1, int64_t(0)), right = min(x + 1, coords.x.width - 1);
  int64_t const above = max(y - 1, int64_t(0)), below = min(y + 1, coords.x.height - 1);
  F const across = right > left ? 1 / F(right - left) : F(0), down = below > above ? 1 / F(below - above) : F(0);
  auto const slope_x = [&](Images<F const> const& map) {
    F const* const row = map.row(b, 0, y);
    return (row[right * map.step] - row[left * map.step]) * across;
  };
  auto const slope_y = [&](Images<F const> const& map) {
    return (map.row(b, 0, below)[x * map.step] - map.row(b, 0, above)[x * map.step]) * down;
  };
  return {slope_x(coords.x) * coords.scale[0] + coords.own, slope_y(coords.x) * coords.scale[0],
          slope_x(coords.y) * coords.scale[1], slope_y(coords.y) * coords.scale[1] + coords.own};
}

// S^-1, symmetric, and how far taps may be from the center along both axes.
template <class F>
struct Footprint {
  F xx, xy, yy, reach_x, reach_y;

  KV_HD bool is_plain() const { return xx == 1 && xy == 0 && yy == 1; }
  // Whether weights are products of one along each axis: xy is 0, or a rounding error, as that of rotations.
  KV_HD bool is_separable() const {
    return magnitude(xy) * max(reach_x, reach_y) < (sizeof(F) == 4 ? F(1e-6) : F(1e-15));
  }
};

// What lies between J and S^-1: J J^T = [[p, q], [q, r]] has the eigenvalues s1^2 >= s2^2.
template <class F>
struct Shrink {
  Jacobian<F> j;
  F q, e, d, det, s1, s2, g1, g2, ratio, beta;
  bool clamped1, clamped2;

  KV_HD static F bounded(F x) {
    F const limit = F(kMaxSlope);
    return x != x ? F(0) : min(max(x, -limit), limit);
  }
  KV_HD explicit Shrink(Jacobian<F> const& by) : j{bounded(by.ux), bounded(by.uy), bounded(by.vx), bounded(by.vy)} {
    F const p = j.ux * j.ux + j.uy * j.uy, r = j.vx * j.vx + j.vy * j.vy;
    q = j.ux * j.vx + j.uy * j.vy;
    e = (p - r) / 2;
    d = sqrt(e * e + q * q);
    det = j.ux * j.vy - j.uy * j.vx;
    s1 = sqrt((p + r) / 2 + d);
    s2 = s1 > 0 ? magnitude(det) / s1 : F(0);
    clamped1 = s1 < 1 || s1 > F(kMaxShrink);
    clamped2 = s2 < 1 || s2 > F(kMaxShrink);
    g1 = min(max(s1, F(1)), F(kMaxShrink));
    g2 = min(max(s2, F(1)), F(kMaxShrink));
    // (g1 - g2) / (s1 - s2), which is 1 for axes of one length, too.
    ratio = !clamped1 && !clamped2 ? F(1) : s1 > s2 ? (g1 - g2) / (s1 - s2) : F(0);
    beta = s1 > 0 ? -ratio / (g1 * g2 * (s1 + s2)) : F(0);
  }
  KV_HD Footprint<F> footprint() const {
    F const inverse = 1 / g1, forward = -beta * g1 * g2;
    F const sx = g1 + forward * (e - d), sy = g1 - forward * (e + d), across = magnitude(forward * q);
    return {inverse + beta * (e - d), beta * q, inverse - beta * (e + d), sx + across, sy + across};
  }
  // The gradient of J, from those of S^-1.
  KV_HD Jacobian<F> vjp(F by_xx, F by_xy, F by_yy) const {
    if (s1 == 0) return {0, 0, 0, 0};
    F const both = by_xx + by_yy;
    F const by_beta = by_xx * (e - d) - by_yy * (e + d) + by_xy * q;
    F by_e = beta * (by_xx - by_yy), by_d = -beta * both, by_q = beta * by_xy;
    // beta = -ratio / (g1 g2 (s1 + s2))
    F by_g1 = -both / (g1 * g1) - by_beta * beta / g1, by_g2 = -by_beta * beta / g2;
    F by_s1 = -by_beta * beta / (s1 + s2), by_s2 = by_s1;
    if ((clamped1 || clamped2) && s1 > s2) {
      F const by_ratio = -by_beta / (g1 * g2 * (s1 + s2)), apart = 1 / (s1 - s2);
      by_g1 += by_ratio * apart;
      by_g2 -= by_ratio * apart;
      by_s1 -= by_ratio * ratio * apart;
      by_s2 += by_ratio * ratio * apart;
    }
    if (!clamped1) by_s1 += by_g1;
    if (!clamped2) by_s2 += by_g2;
    // s2 = |det| / s1
    F const by_det = by_s2 / s1 * (det < 0 ? F(-1) : det > 0 ? F(1) : F(0));
    by_s1 -= by_s2 * s2 / s1;
    F const by_square = by_s1 / (2 * s1);  // of (p + r) / 2 + d
    by_d += by_square;
    if (d > 0) {
      by_e += by_d * e / d;
      by_q += by_d * q / d;
    }
    F const by_p = (by_square + by_e) / 2, by_r = (by_square - by_e) / 2;
    auto const kept = [](F x, F g) { return magnitude(x) < F(kMaxSlope) ? g : F(0); };
    return {kept(j.ux, 2 * by_p * j.ux + by_q * j.vx + by_det * j.vy),
            kept(j.uy, 2 * by_p * j.uy + by_q * j.vy - by_det * j.vx),
            kept(j.vx, 2 * by_r * j.vx + by_q * j.ux - by_det * j.uy),
            kept(j.vy, 2 * by_r * j.vy + by_q * j.uy + by_det * j.ux)};
  }
};

template <class F>
KV_HD Footprint<F> footprint(Jacobian<F> const& j) {
  return Shrink<F>(j).footprint();
}

template <class F>
KV_HD F triangle(F q) {
  F const w = 1 - magnitude(q);
  return w > 0 ? w : F(0);
}
// Its derivative from the right, as that of bilinear weights is.
template <class F>
KV_HD F triangle_slope(F q) {
  return q > -1 && q <= 0 ? F(1) : q > 0 && q <= 1 ? F(-1) : F(0);
}

// The taps around a coordinate: pixels [first, last] along each axis.
template <class F>
struct CoveredTaps {
  F u, v;
  int first_x, last_x, first_y, last_y;

  template <class T>
  KV_HD CoveredTaps(Sampling<T> const& p, F to_u, F to_v, Footprint<F> const& f)
      : u(near(p.x_axis, to_u)), v(near(p.y_axis, to_v)) {
    bounds(u, f.reach_x, first_x, last_x);
    bounds(v, f.reach_y, first_y, last_y);
  }
  template <class T>
  KV_HD bool is_inside(Sampling<T> const& p) const {
    return first_x >= 0 && last_x < p.x_axis.size && first_y >= 0 && last_y < p.y_axis.size;
  }
  // Whether all taps are the fill.
  template <class T>
  KV_HD bool is_outside(Sampling<T> const& p) const {
    return p.x_axis.padding == Padding::fill &&
           (last_x < 0 || first_x >= p.x_axis.size || last_y < 0 || first_y >= p.y_axis.size);
  }

  // Whether a coordinate may move without a change of the result, so that it has no gradient.
  KV_HD static bool is_fixed(Axis<F> const& axis, F x) {
    if (period(axis) > 0) return x - x != 0;
    return !(x > F(-2 * kMaxReach)) || x > F(axis.size + 2 * kMaxReach);
  }

 private:
  // Of reflections, or 0 where there are none: between the centers of one pixel they are that pixel, as is a border.
  KV_HD static F period(Axis<F> const& axis) {
    return axis.padding == Padding::reflection ? F(2 * (axis.align_corners ? axis.size - 1 : axis.size)) : F(0);
  }
  // An equivalent coordinate near the image; NaN is out of bounds to the left.
  KV_HD static F near(Axis<F> const& axis, F x) {
    F const period = CoveredTaps::period(axis);
    if (period == 0) {
      F const low = F(-2 * kMaxReach), high = F(axis.size + 2 * kMaxReach);
      return x > low ? min(x, high) : low;
    }
    F const whole = x / period;
    x -= period * (sizeof(F) == 4 ? F(__builtin_floorf(float(whole))) : F(__builtin_floor(double(whole))));
    return x > 0 ? min(x, period) : F(0);
  }
  KV_HD static void bounds(F center, F reach, int& first, int& last) {
    reach = min(reach, F(kMaxReach - 1));
    F const low = center - reach, high = center + reach;
    first = int(low);
    first += F(first) < low;
    last = int(high);
    last -= F(last) > high;
  }
};

// The pixel of tap i, or -1 where it is the fill. Taps may be many times the size of the image away.
template <class F>
KV_HD int padded_pixel(Axis<F> const& axis, int i) {
  int const n = axis.size;
  if (unsigned(i) < unsigned(n)) return i;
  if (axis.padding == Padding::fill) return -1;
  if (axis.padding == Padding::border) return i < 0 ? 0 : n - 1;
  int const period = 2 * (axis.align_corners ? n - 1 : n);
  if (period == 0) return 0;
  i %= period;
  i = i < 0 ? i + period : i;
  return i < n ? i : period - i - (axis.align_corners ? 0 : 1);
}

// The sums of a pixel from which its value and its gradients follow: of weights w, of their derivatives by the center
// and by S^-1, each alone and times what the pixels are multiplied with.
template <class F>
struct TapSums {
  F weight = 0, value = 0;
  F plain[5] = {}, times[5] = {};  // by q_x and q_y; then xx, xy and yy

  KV_HD void add(Footprint<F> const& f, F dx, F dy, F x) {
    F const qx = f.xx * dx + f.xy * dy, qy = f.xy * dx + f.yy * dy;
    F const tx = triangle(qx), ty = triangle(qy), w = tx * ty;
    F const hx = triangle_slope(qx) * ty, hy = triangle_slope(qy) * tx;
    if (w > 0) {
      weight += w;
      value += w * x;
    }
    if (hx == 0 && hy == 0) return;
    F const by[] = {hx, hy, hx * dx, hx * dy + hy * dx, hy * dy};
    for (int i = 0; i < 5; ++i) {
      plain[i] += by[i];
      times[i] += by[i] * x;
    }
  }
  // The gradients of the sampling coordinates, and of J.
  KV_HD void gradients(Shrink<F> const& shrink, Footprint<F> const& f, F& by_u, F& by_v, Jacobian<F>& by_j) const {
    F const mean = value / weight;
    F g[5];
    for (int i = 0; i < 5; ++i) g[i] = (times[i] - mean * plain[i]) / weight;
    by_u = -(g[0] * f.xx + g[1] * f.xy);
    by_v = -(g[0] * f.xy + g[1] * f.yy);
    by_j = shrink.vjp(g[2], g[3], g[4]);
  }
};

// The gradients by maps: of the coordinates, and of J, (B, 4, h, w), in the units of the maps.
template <class T>
struct AntialiasedCoordsBackward : SampleCoordsBackward<T> {
  Images<Compute<T>> grad_jacobian;
};

// Adds to the gradients of maps what the differences of their numbers, which J is made of, contribute.
template <class F>
struct MapDifferencesBackward {
  Images<F const> grad_jacobian;
  Images<F> grad_x, grad_y;

  // Of axis x or y, at a pixel.
  KV_HD F at(int64_t b, int component, int64_t y, int64_t x, bool along_x) const {
    Images<F const> const& g = grad_jacobian;
    int64_t const n = along_x ? g.width : g.height, i = along_x ? x : y;
    if (n == 1) return 0;
    auto const weighted = [&](int64_t k) {
      F const grad = along_x ? g.row(b, component, y)[k] : g.row(b, component, k)[x];
      return k == 0 || k == n - 1 ? grad : grad / 2;
    };
    F const before = i == 0 ? -weighted(0) : weighted(i - 1), after = i == n - 1 ? -weighted(n - 1) : weighted(i + 1);
    return before - after;
  }
  KV_HD void add(int64_t b, int64_t y, int64_t x) const {
    grad_x.row(b, 0, y)[x] += at(b, 0, y, x, true) + at(b, 1, y, x, false);
    grad_y.row(b, 0, y)[x] += at(b, 2, y, x, true) + at(b, 3, y, x, false);
  }
};

constexpr int kGatherTile = 64;  // pixels of an image whose gradients a block of threads gathers, along each axis

KV_KERNEL(sample_antialiased, Sample)
KV_KERNEL(sample_antialiased_image_backward, SampleImageBackward)
KV_KERNEL(sample_antialiased_coords_backward, AntialiasedCoordsBackward)
KV_KERNEL(map_differences_backward, MapDifferencesBackward)

}  // namespace kv::geometry
