// Residuals of correspondences under the matrix that relates two images, squared where the comment says so. Below each
// is its vjp in double: it adds to the gradients of both points and of the nine entries of the matrix. V is a number or
// Lanes.
#pragma once

#include "core/hd.h"

namespace kv::geometry {

// The width of points that count as on one line, in units of the size of their coordinates: of float32, which rounds
// them, and of float64, whose moments are sums.
constexpr double kLineWidth = 1.2e-7, kLineWidth64 = 3e-8;

// Of points with D coordinates: their number, the sums of coordinates, and those of products of two.
template <int D>
struct Moments {
  static constexpr int kCount = 1 + D + D * (D + 1) / 2;

  static KV_HD void add(double const* x, double* sums) {
    sums[0] += 1;
    for (int i = 0, at = 1 + D; i < D; ++i) {
      sums[1 + i] += x[i];
      for (int k = i; k < D; ++k) sums[at++] += x[i] * x[k];
    }
  }
  // Whether the points are on one line: their second largest variance is small.
  static KV_HD bool are_on_line(double const* sums, bool is_double) {
    double const n = max(sums[0], 1.), width = is_double ? kLineWidth64 : kLineWidth;
    double variances[D][D], total = 0, size = 0, area = 0;
    for (int i = 0, at = 1 + D; i < D; ++i) {
      size += sums[at] / n;
      for (int k = i; k < D; ++k) variances[i][k] = sums[at++] / n - sums[1 + i] / n * (sums[1 + k] / n);
      total += variances[i][i];
    }
    for (int i = 0; i < D; ++i)
      for (int k = i + 1; k < D; ++k) area += variances[i][i] * variances[k][k] - variances[i][k] * variances[i][k];
    return !(area > total * (width * width) * size);
  }
};

// H (x, y, 1).
template <class V, class F>
struct Mapped {
  V u, v, w;
  KV_HD Mapped(F const* m, V x, V y)
      : u(x * m[0] + (y * m[1] + m[2])), v(x * m[3] + (y * m[4] + m[5])), w(x * m[6] + (y * m[7] + m[8])) {}
};

KV_HD void mapped_vjp(double const* m, double x, double y, double const* g, double* grad_point, double* grad_matrix) {
  for (int r = 0; r < 3; ++r) {
    grad_point[0] += g[r] * m[3 * r], grad_point[1] += g[r] * m[3 * r + 1];
    grad_matrix[3 * r] += g[r] * x, grad_matrix[3 * r + 1] += g[r] * y, grad_matrix[3 * r + 2] += g[r];
  }
}

// A squared error as a fraction.
template <class V>
struct Fraction {
  V above, below;
  KV_HD V value() const { return above / below; }
};

// The squared distance of the point that a homography maps (x, y) to, from (u, v).
template <class V, class F>
KV_HD Fraction<V> transfer_fraction(F const* m, V x, V y, V u, V v) {
  Mapped<V, F> const h(m, x, y);
  V const p = h.u - h.w * u, q = h.v - h.w * v;
  return {p * p + q * q, h.w * h.w};
}
template <class V, class F>
KV_HD V transfer_error(F const* m, V x, V y, V u, V v) {
  return transfer_fraction(m, x, y, u, v).value();
}

KV_HD void transfer_error_vjp(double const* m, double const* one, double const* two, double g, double* grad_one,
                              double* grad_two, double* grad_matrix) {
  Mapped<double, double> const h(m, one[0], one[1]);
  double const p = h.u / h.w - two[0], q = h.v / h.w - two[1];
  double const grad_u = 2 * g * p / h.w, grad_v = 2 * g * q / h.w;
  double const grad_h[] = {grad_u, grad_v, -(grad_u * h.u + grad_v * h.v) / h.w};
  grad_two[0] -= 2 * g * p, grad_two[1] -= 2 * g * q;
  mapped_vjp(m, one[0], one[1], grad_h, grad_one, grad_matrix);
}

// The epipolar lines (a, b, e) = F (x, y, z) and (c, d, .) = F^T (u, v, t), and r = (u, v, t) F (x, y, z).
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

// From the gradients to r and to the squared lengths of both lines' normals.
KV_HD void epipolar_vjp(double const* m, double const* one, double const* two, double grad_r, double grad_second,
                        double grad_first, double* grad_one, double* grad_two, double* grad_matrix) {
  Epipolar<double, double> const l(m, one[0], one[1], one[2], two[0], two[1], two[2]);
  double const line[] = {l.a, l.b, l.e};
  double const grad_line2[] = {grad_r * two[0] + 2 * grad_second * l.a, grad_r * two[1] + 2 * grad_second * l.b,
                               grad_r * two[2]};
  double const grad_line1[] = {2 * grad_first * l.c, 2 * grad_first * l.d};
  for (int i = 0; i < 3; ++i) {
    grad_two[i] += grad_r * line[i] + grad_line1[0] * m[3 * i] + grad_line1[1] * m[3 * i + 1];
    for (int k = 0; k < 3; ++k) {
      grad_one[k] += grad_line2[i] * m[3 * i + k];
      grad_matrix[3 * i + k] += grad_line2[i] * one[k] + (k < 2 ? two[i] * grad_line1[k] : 0);
    }
  }
}

// Sampson's distance, squared: that of both points from the nearest exact correspondence, to first order.
template <class V, class F>
KV_HD Fraction<V> sampson_fraction(F const* m, V x, V y, V u, V v) {
  V const one = V{} + 1;
  Epipolar<V, F> const l(m, x, y, one, u, v, one);
  return {l.r * l.r, l.second() + l.first()};
}
template <class V, class F>
KV_HD V sampson_error(F const* m, V x, V y, V u, V v) {
  return sampson_fraction(m, x, y, u, v).value();
}

// Sampson's distance from a homography, squared: r (J J^T)^-1 r for r = (v w - q, p - u w), where (p, q, w) = H (x, y,
// 1), and J is the Jacobian of r by (x, y, u, v). J J^T has the entries a, b, b, c.
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
  static KV_HD double clamp_to_zero(double x) { return x < 0 ? 0 : x; }
  KV_HD double volume() const { return clamp_to_zero(a * c - b * b); }
  KV_HD double error() const { return clamp_to_zero((c * r * r - 2 * b * r * s + a * s * s) / volume()); }

  KV_HD void vjp(double const* m, double const* one, double const* two, double g, double* grad_one, double* grad_two,
                 double* grad_matrix) const {
    double const e = error();
    g /= volume();
    double const grad_r = 2 * g * (c * r - b * s), grad_s = 2 * g * (a * s - b * r);
    double const grad_a = g * (s * s - e * c), grad_c = g * (r * r - e * a), grad_b = 2 * g * (e * b - r * s);
    double const grad_rows[2][2] = {{2 * r_x * grad_a + s_x * grad_b, 2 * r_y * grad_a + s_y * grad_b},
                                    {2 * s_x * grad_c + r_x * grad_b, 2 * s_y * grad_c + r_y * grad_b}};
    for (int k = 0; k < 2; ++k) {
      grad_two[0] -= m[6 + k] * grad_rows[1][k], grad_two[1] += m[6 + k] * grad_rows[0][k];
      grad_matrix[k] += grad_rows[1][k], grad_matrix[3 + k] -= grad_rows[0][k];
      grad_matrix[6 + k] += two[1] * grad_rows[0][k] - two[0] * grad_rows[1][k];
    }
    grad_two[0] -= h.w * grad_s, grad_two[1] += h.w * grad_r;
    double const grad_h[] = {grad_s, -grad_r, 2 * h.w * (grad_a + grad_c) + two[1] * grad_r - two[0] * grad_s};
    mapped_vjp(m, one[0], one[1], grad_h, grad_one, grad_matrix);
  }
};

// The signed distance of H (x, y) from the line through (u, v) and (s, t), times the length of that segment.
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

KV_HD void line_offset_vjp(double const* m, double const* point, double const* ends, double g, double* grad_point,
                           double* grad_ends, double* grad_matrix) {
  Mapped<double, double> const h(m, point[0], point[1]);
  double const x = h.u / h.w, y = h.v / h.w, dx = ends[2] - ends[0], dy = ends[3] - ends[1];
  double const grad_h[] = {g * dy / h.w, -g * dx / h.w, -g * (dy * x - dx * y) / h.w};
  mapped_vjp(m, point[0], point[1], grad_h, grad_point, grad_matrix);
  grad_ends[0] += g * ((y - ends[1]) - dy), grad_ends[1] += g * (dx - (x - ends[0]));
  grad_ends[2] -= g * (y - ends[1]), grad_ends[3] += g * (x - ends[0]);
}

}  // namespace kv::geometry
