// DLT of fundamental matrices; see dlt.h.
#pragma once

#include "geometry/solvers/dlt_homography.h"

namespace kv::geometry::dlt_models {

struct Fundamental {
  static constexpr int kAxes = 2, kPoints = 1, kUnknowns = 9, kOutputSize = 9;

  template <class Group>
  static KV_CALLED void normal_matrix(Problem<2> const& problem, Group group, double* m) {
    auto const pair = [&](int64_t i, double* n1, double* n2) KV_INLINE {
      problem.normalized(i, n1, n2);
      return problem.weights[i];
    };
    sum_products(problem.weights.count, group, pair, m);
  }

  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double by_u[3], by_h[3];
    for (int r = 0; r < 3; ++r) by_u[r] = dot3(u + 3 * r, n1), by_h[r] = dot3(h + 3 * r, n1);
    double const a = dot3(by_u, n2), c = dot3(by_h, n2);
    for (int k = 0; k < 2; ++k) {
      g2[k] = -w * (c * by_u[k] + a * by_h[k]);
      g1[k] = 0;
      for (int r = 0; r < 3; ++r) g1[k] -= w * n2[r] * (c * u[3 * r + k] + a * h[3 * r + k]);
    }
    return -a * c;
  }

  static KV_HD void constrain(double const* h, double* f) {
    double v[3];
    for (int i = 0; i < 9; ++i) f[i] = h[i];
    small::project_to_rank_two(f, v);
  }
  // The gradient of F - F v v^T, where v is the eigenvector of the smallest eigenvalue of F^T F.
  static KV_CALLED void constrain_vjp(double const* h, double* g) {
    double f[9], v[3], square[9], grad_v[3], u[3], fv[3], gv[3], fu[3];
    for (int i = 0; i < 9; ++i) f[i] = h[i];
    if (!small::project_to_rank_two(f, v)) return;
    for (int r = 0; r < 3; ++r) fv[r] = dot3(h + 3 * r, v), gv[r] = dot3(g + 3 * r, v);
    for (int i = 0; i < 3; ++i) {
      grad_v[i] = 0;
      for (int r = 0; r < 3; ++r) grad_v[i] -= h[3 * r + i] * gv[r] + g[3 * r + i] * fv[r];
      for (int k = 0; k < 3; ++k) square[3 * i + k] = h[i] * h[k] + h[3 + i] * h[3 + k] + h[6 + i] * h[6 + k];
    }
    small::smallest_eigenvector_vjp<3>(square, v, grad_v, u);
    for (int r = 0; r < 3; ++r) fu[r] = dot3(h + 3 * r, u);
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 3; ++k) g[3 * r + k] -= gv[r] * v[k] + fu[r] * v[k] + fv[r] * u[k];
  }

  // Sets m to T2^T times a matrix.
  static KV_HD void denormalize_left(Image<2> const& image2, double const* denormalize_right, double* m) {
    for (int k = 0; k < 3; ++k) {
      for (int r = 0; r < 2; ++r) m[3 * r + k] = image2.scale * denormalize_right[3 * r + k];
      m[6 + k] = denormalize_right[6 + k] - m[k] * image2.mean[0] - m[3 + k] * image2.mean[1];
    }
  }
  static KV_HD void denormalize_left_vjp(Image<2> const& image2, double const* denormalize_right, double* g,
                                         ImageGradients<2>& grad_image2) {
    for (int k = 0; k < 3; ++k)
      for (int r = 0; r < 2; ++r) {
        double const inner = g[3 * r + k] - g[6 + k] * image2.mean[r];
        grad_image2.scale += inner * denormalize_right[3 * r + k];
        grad_image2.mean[r] -= g[6 + k] * image2.scale * denormalize_right[3 * r + k];
        g[3 * r + k] = image2.scale * inner;
      }
  }
  static KV_HD void finish(double const* m, double* result) { to_unit_last(m, result); }
  static KV_HD void finish_vjp(double const* m, double* g) { to_unit_last_vjp(m, g); }
  template <class T, class Group>
  static KV_HD bool is_solvable(Dlt<T> const&, Problem<2> const&, Group) {
    return true;
  }
};

}  // namespace kv::geometry::dlt_models
