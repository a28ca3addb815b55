// DLT of homographies, from points or from segments; see dlt.h.
#pragma once

#include "geometry/solvers/dlt_problem.h"

namespace kv::geometry::dlt_models {

// --- maps from points of D coordinates to the second image -----------------------------------------------------------

template <int D>
struct Projective {
  static constexpr int kAxes = D, kPoints = 1, C = D + 1, kUnknowns = 3 * C;

  // Sets M, in memory that the group shares. It has five different blocks, of which two are 0: sums of w, -w x, -w y
  // and w (x^2 + y^2) times n1 n1^T.
  template <class Group>
  static KV_CALLED void normal_matrix(Problem<D> const& problem, Group group, double* m) {
    constexpr int kSums = C * (C + 1) / 2;
    double sums[4 * kSums] = {};
    for (int64_t i = group.thread_rank(); i < problem.weights.count; i += group.num_threads()) {
      double n1[C], n2[3];
      problem.normalized(i, n1, n2);
      double const w = problem.weights[i];
      double const factors[] = {w, -w * n2[0], -w * n2[1], w * (n2[0] * n2[0] + n2[1] * n2[1])};
      for (int r = 0, at = 0; r < C; ++r)
        for (int c = 0; c <= r; ++c, ++at)
          for (int f = 0; f < 4; ++f) sums[f * kSums + at] += factors[f] * n1[r] * n1[c];
    }
    double const* const all = group.sums(sums);
    for (int row = group.thread_rank(); row < kUnknowns; row += group.num_threads()) {
      int const r = row / C, i = row % C;
      for (int c = 0; c < 3; ++c) {
        double const* const block = all + (r == c ? (r == 2 ? 3 : 0) : r + c - 1) * kSums;
        for (int k = 0; k < C; ++k)
          m[row * kUnknowns + c * C + k] = r != c && r + c == 1 ? 0 : block[packed_index(i, k)];
      }
    }
    group.sync();
  }

  // The gradient of -u^T (sum w r r^T) h to a correspondence: returns that to w, sets those to the normalized points.
  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double const x = n2[0], y = n2[1], square = x * x + y * y;
    double a[3], c[3];
    for (int k = 0; k < 3; ++k) a[k] = product<C>(u + C * k, n1), c[k] = product<C>(h + C * k, n1);
    double const cross_x = a[0] * c[2] + a[2] * c[0], cross_y = a[1] * c[2] + a[2] * c[1];
    g2[0] = -w * (2 * x * a[2] * c[2] - cross_x);
    g2[1] = -w * (2 * y * a[2] * c[2] - cross_y);
    double const grad_a[] = {c[0] - x * c[2], c[1] - y * c[2], square * c[2] - x * c[0] - y * c[1]};
    double const grad_c[] = {a[0] - x * a[2], a[1] - y * a[2], square * a[2] - x * a[0] - y * a[1]};
    for (int k = 0; k < D; ++k) {
      g1[k] = 0;
      for (int r = 0; r < 3; ++r) g1[k] -= w * (grad_a[r] * u[C * r + k] + grad_c[r] * h[C * r + k]);
    }
    return -(a[0] * c[0] + a[1] * c[1] + square * a[2] * c[2] - x * cross_x - y * cross_y);
  }

  // Constrains the eigenvector h to a valid model. Here every h is valid.
  static KV_HD void constrain(double const* h, double* f) {
    for (int i = 0; i < kUnknowns; ++i) f[i] = h[i];
  }
  static KV_HD void constrain_vjp(double const*, double*) {}

  // Sets m to T2^-1 times a matrix, up to scale.
  static KV_HD void denormalize_left(Image<2> const& image2, double const* denormalize_right, double* m) {
    double const* const last = denormalize_right + 2 * C;
    for (int k = 0; k < C; ++k) {
      for (int r = 0; r < 2; ++r) m[r * C + k] = denormalize_right[r * C + k] + image2.scale * image2.mean[r] * last[k];
      m[2 * C + k] = image2.scale * last[k];
    }
  }
  static KV_HD void denormalize_left_vjp(Image<2> const& image2, double const* denormalize_right, double* g,
                                         ImageGradients<2>& grad_image2) {
    double const* const last = denormalize_right + 2 * C;
    for (int k = 0; k < C; ++k) {
      for (int r = 0; r < 2; ++r) grad_image2.mean[r] += image2.scale * g[r * C + k] * last[k];
      double const by_scale = image2.mean[0] * g[k] + image2.mean[1] * g[C + k] + g[2 * C + k];
      grad_image2.scale += by_scale * last[k];
      g[2 * C + k] = image2.scale * by_scale;
    }
  }
};

// The number that a matrix is divided by: its last entry, or the largest magnitude where that entry is 0.
KV_HD double divisor(double const* m, bool& last) {
  double largest = 0;
  for (int i = 0; i < 9; ++i) largest = max(largest, small::magnitude(m[i]));
  last = small::magnitude(m[8]) > 1e-12 * largest;
  return last ? m[8] : largest > 0 ? largest : 1;
}

KV_HD void to_unit_last(double const* m, double* result) {
  bool last;
  double const scale = 1 / divisor(m, last);
  for (int i = 0; i < 9; ++i) result[i] = m[i] * scale;
}
KV_HD void to_unit_last_vjp(double const* m, double* g) {
  bool last;
  double const scale = 1 / divisor(m, last);
  double along = 0;
  for (int i = 0; i < 9; ++i) g[i] *= scale, along += g[i] * m[i] * scale;
  if (last) g[8] -= along;
}

struct Homography : Projective<2> {
  static constexpr int kOutputSize = 9;
  static KV_HD void finish(double const* m, double* result) { to_unit_last(m, result); }
  static KV_HD void finish_vjp(double const* m, double* g) { to_unit_last_vjp(m, g); }
  template <class T, class Group>
  static KV_HD bool is_solvable(Dlt<T> const&, Problem<2> const&, Group) {
    return true;
  }
};

// Sets m, in memory that the group shares, to the sum of w l l^T times n1 n1^T; each factor has six different entries.
// `pair` returns w and sets n1 and l, three numbers each, of a point.
template <class Group, class Pair>
KV_HD void sum_products(int64_t count, Group group, Pair pair, double* m) {
  double sums[36] = {};
  for (int64_t i = group.thread_rank(); i < count; i += group.num_threads()) {
    double n1[3], n2[3], products[6];
    double const w = pair(i, n1, n2);
    for (int r = 0, at = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++at) products[at] = n1[r] * n1[c];
    for (int r = 0, at = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++at)
        for (int k = 0; k < 6; ++k) sums[6 * at + k] += w * n2[r] * n2[c] * products[k];
  }
  double const* const all = group.sums(sums);
  for (int row = group.thread_rank(); row < 9; row += group.num_threads())
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < 3; ++k) m[9 * row + 3 * c + k] = all[6 * packed_index(row / 3, c) + packed_index(row % 3, k)];
  group.sync();
}

// --- homographies of segments, from their ends to lines --------------------------------------------------------------

struct Lines : Homography {
  static constexpr int kPoints = 2;

  template <class Group>
  static KV_CALLED void normal_matrix(Problem<2, 2> const& problem, Group group, double* m) {
    auto const end = [&](int64_t i, double* n1, double* line) KV_INLINE {
      double start[3], end[3], other[3];
      problem.normalized(i ^ 1, other, start);
      problem.normalized(i, n1, end);
      cross3(start, end, line);  // its sign does not matter
      return problem.weights[i / 2];
    };
    sum_products(2 * problem.weights.count, group, end, m);
  }
  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double line[3], grad_line[3] = {}, grad_ends[3], grad_weight = 0;
    cross3(n2, n2 + 3, line);
    for (int end = 0; end < 2; ++end) {
      double by_u[3], by_h[3];
      for (int r = 0; r < 3; ++r) by_u[r] = dot3(u + 3 * r, n1 + 3 * end), by_h[r] = dot3(h + 3 * r, n1 + 3 * end);
      double const a = dot3(by_u, line), c = dot3(by_h, line);
      grad_weight -= a * c;
      for (int k = 0; k < 3; ++k) grad_line[k] -= w * (c * by_u[k] + a * by_h[k]);
      for (int k = 0; k < 2; ++k) {
        g1[2 * end + k] = 0;
        for (int r = 0; r < 3; ++r) g1[2 * end + k] -= w * line[r] * (c * u[3 * r + k] + a * h[3 * r + k]);
      }
    }
    cross3(n2 + 3, grad_line, grad_ends);
    g2[0] = grad_ends[0], g2[1] = grad_ends[1];
    cross3(grad_line, n2, grad_ends);
    g2[2] = grad_ends[0], g2[3] = grad_ends[1];
    return grad_weight;
  }
  template <class T, class Group>
  static KV_HD bool is_solvable(Dlt<T> const&, Problem<2, 2> const&, Group) {
    return true;
  }
};

}  // namespace kv::geometry::dlt_models
