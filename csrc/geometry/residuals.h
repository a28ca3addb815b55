// How far a correspondence is from what relates two images, squared where it says so, and below each its gradient in
// double: to both points, to which `a` and `b` are added, and to the nine numbers of the matrix. V is a number or
// Lanes.
#pragma once

#include "core/hd.h"

namespace kv {

// H (x, y, 1).
template <class V, class F>
struct Mapped {
  V u, v, w;
  KV_HD Mapped(F const* m, V x, V y)
      : u(x * m[0] + (y * m[1] + m[2])), v(x * m[3] + (y * m[4] + m[5])), w(x * m[6] + (y * m[7] + m[8])) {}
};

KV_HD void mapped_vjp(double const* m, double x, double y, double const* g, double* to_point, double* to_matrix) {
  for (int r = 0; r < 3; ++r) {
    to_point[0] += g[r] * m[3 * r], to_point[1] += g[r] * m[3 * r + 1];
    to_matrix[3 * r] += g[r] * x, to_matrix[3 * r + 1] += g[r] * y, to_matrix[3 * r + 2] += g[r];
  }
}

// The squared distance of where a homography takes (x, y) from (u, v).
template <class V, class F>
KV_HD V transfer_error(F const* m, V x, V y, V u, V v) {
  Mapped<V, F> const h(m, x, y);
  V const p = h.u - h.w * u, q = h.v - h.w * v;
  return (p * p + q * q) / (h.w * h.w);
}

KV_HD void transfer_error_vjp(double const* m, double const* one, double const* two, double g, double* to_one,
                              double* to_two, double* to_matrix) {
  Mapped<double, double> const h(m, one[0], one[1]);
  double const p = h.u / h.w - two[0], q = h.v / h.w - two[1];
  double const to_u = 2 * g * p / h.w, to_v = 2 * g * q / h.w;
  double const to[] = {to_u, to_v, -(to_u * h.u + to_v * h.v) / h.w};
  to_two[0] -= 2 * g * p, to_two[1] -= 2 * g * q;
  mapped_vjp(m, one[0], one[1], to, to_one, to_matrix);
}

// The lines (a, b, e) = F (x, y, z) and (c, d, .) = F^T (u, v, t), and r = (u, v, t) F (x, y, z).
template <class V, class F>
struct Epipolar {
  V a, b, e, c, d, r;
  KV_HD Epipolar(F const* m, V x, V y, V z, V u, V v, V t)
      : a(x * m[0] + (y * m[1] + z * m[2])),
        b(x * m[3] + (y * m[4] + z * m[5])),
        e(x * m[6] + (y * m[7] + z * m[8])),
        c(u * m[0] + (v * m[3] + t * m[6])),
        d(u * m[1] + (v * m[4] + t * m[7])),
        r(a * u + (b * v + e * t)) {}
  KV_HD V second() const { return a * a + b * b; }
  KV_HD V first() const { return c * c + d * d; }
};

// From the gradients to r and to the squares of both lines' lengths.
KV_HD void epipolar_vjp(double const* m, double const* one, double const* two, double to_r, double to_second,
                        double to_first, double* to_one, double* to_two, double* to_matrix) {
  Epipolar<double, double> const l(m, one[0], one[1], one[2], two[0], two[1], two[2]);
  double const line[] = {l.a, l.b, l.e};
  double const across[] = {to_r * two[0] + 2 * to_second * l.a, to_r * two[1] + 2 * to_second * l.b, to_r * two[2]};
  double const back[] = {2 * to_first * l.c, 2 * to_first * l.d};
  for (int i = 0; i < 3; ++i) {
    to_two[i] += to_r * line[i] + back[0] * m[3 * i] + back[1] * m[3 * i + 1];
    for (int k = 0; k < 3; ++k) {
      to_one[k] += across[i] * m[3 * i + k];
      to_matrix[3 * i + k] += across[i] * one[k] + (k < 2 ? two[i] * back[k] : 0);
    }
  }
}

// Sampson's distance, squared: how far both points are from the nearest ones that fit, to first order.
template <class V, class F>
KV_HD V sampson_error(F const* m, V x, V y, V u, V v) {
  V const one = V{} + 1;
  Epipolar<V, F> const l(m, x, y, one, u, v, one);
  return l.r * l.r / (l.second() + l.first());
}

// Sampson's distance from a homography, squared: r (J J^T)^-1 r for r = (v w - q, p - u w), where (p, q, w) = H (x, y,
// 1), and its derivative J for (x, y, u, v). a, b, b, c are the numbers of J J^T.
struct SampsonTransfer {
  Mapped<double, double> h;
  double r, s, r_x, r_y, s_x, s_y, a, b, c;

  KV_HD SampsonTransfer(double const* m, double const* one, double const* two)
      : h(m, one[0], one[1]),
        r(two[1] * h.w - h.v),
        s(h.u - two[0] * h.w),
        r_x(two[1] * m[6] - m[3]),
        r_y(two[1] * m[7] - m[4]),
        s_x(m[0] - two[0] * m[6]),
        s_y(m[1] - two[0] * m[7]),
        a(r_x * r_x + r_y * r_y + h.w * h.w),
        b(r_x * s_x + r_y * s_y),
        c(s_x * s_x + s_y * s_y + h.w * h.w) {}
  static KV_HD double above0(double x) { return x < 0 ? 0 : x; }
  KV_HD double volume() const { return above0(a * c - b * b); }
  KV_HD double error() const { return above0((c * r * r - 2 * b * r * s + a * s * s) / volume()); }

  KV_HD void vjp(double const* m, double const* one, double const* two, double g, double* to_one, double* to_two,
                 double* to_matrix) const {
    double const e = error();
    g /= volume();
    double const to_r = 2 * g * (c * r - b * s), to_s = 2 * g * (a * s - b * r);
    double const to_a = g * (s * s - e * c), to_c = g * (r * r - e * a), to_b = 2 * g * (e * b - r * s);
    double const to_rows[2][2] = {{2 * r_x * to_a + s_x * to_b, 2 * r_y * to_a + s_y * to_b},
                                  {2 * s_x * to_c + r_x * to_b, 2 * s_y * to_c + r_y * to_b}};
    for (int k = 0; k < 2; ++k) {
      to_two[0] -= m[6 + k] * to_rows[1][k], to_two[1] += m[6 + k] * to_rows[0][k];
      to_matrix[k] += to_rows[1][k], to_matrix[3 + k] -= to_rows[0][k];
      to_matrix[6 + k] += two[1] * to_rows[0][k] - two[0] * to_rows[1][k];
    }
    to_two[0] -= h.w * to_s, to_two[1] += h.w * to_r;
    double const to[] = {to_s, -to_r, 2 * h.w * (to_a + to_c) + two[1] * to_r - two[0] * to_s};
    mapped_vjp(m, one[0], one[1], to, to_one, to_matrix);
  }
};

// Of the line through (u, v) and (s, t), from where (x, y) goes: the distance times the segment's length, with a sign.
template <class V, class F>
KV_HD V line_offset(F const* m, V x, V y, V u, V v, V s, V t) {
  Mapped<V, F> const h(m, x, y);
  return (h.u / h.w - u) * (t - v) - (h.v / h.w - v) * (s - u);
}
template <class V, class F>
KV_HD V line_error(F const* m, V x, V y, V u, V v, V s, V t) {
  V const offset = line_offset(m, x, y, u, v, s, t);
  return offset < 0 ? -offset : offset;
}

KV_HD void line_offset_vjp(double const* m, double const* point, double const* ends, double g, double* to_point,
                           double* to_ends, double* to_matrix) {
  Mapped<double, double> const h(m, point[0], point[1]);
  double const x = h.u / h.w, y = h.v / h.w, along = ends[2] - ends[0], down = ends[3] - ends[1];
  double const to[] = {g * down / h.w, -g * along / h.w, -g * (down * x - along * y) / h.w};
  mapped_vjp(m, point[0], point[1], to, to_point, to_matrix);
  to_ends[0] += g * ((y - ends[1]) - down), to_ends[1] += g * (along - (x - ends[0]));
  to_ends[2] -= g * (y - ends[1]), to_ends[3] += g * (x - ends[0]);
}

}  // namespace kv
