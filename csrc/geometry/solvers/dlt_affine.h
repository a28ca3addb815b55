// Affine maps by least squares, with the interface of dlt.h.
#pragma once

#include "geometry/solvers/dlt_problem.h"

namespace kv::geometry {

namespace dlt_models {

struct Affine {};

struct AffineFit {
  double inverse_covariance[4], cross_covariance[4], linear[4];  // of S = sum w x x^T; C = sum w x y^T; A = (S^-1 C)^T
  bool is_singular;

  template <class Group>
  KV_HD AffineFit(Problem<2> const& problem, Group group) {
    double sums[7] = {};
    for (int64_t i = group.thread_rank(); i < problem.weights.count; i += group.num_threads()) {
      double x[2], y[2];
      problem.image1.centered(i, x);
      problem.image2.centered(i, y);
      double const w = problem.weights.fraction(i);
      sums[0] += w * x[0] * x[0], sums[1] += w * x[0] * x[1], sums[2] += w * x[1] * x[1];
      for (int k = 0; k < 4; ++k) sums[3 + k] += w * x[k / 2] * y[k % 2];
    }
    for (double& sum : sums) sum = group.sum(sum);
    double const trace = sums[0] + sums[2], area = sums[0] * sums[2] - sums[1] * sums[1];
    is_singular = !(area > 1e-12 * trace * trace);
    inverse_covariance[0] = sums[2] / area, inverse_covariance[3] = sums[0] / area;
    inverse_covariance[1] = inverse_covariance[2] = -sums[1] / area;
    for (int k = 0; k < 4; ++k) cross_covariance[k] = sums[3 + k];
    for (int r = 0; r < 2; ++r)
      for (int c = 0; c < 2; ++c)
        linear[2 * r + c] =
            inverse_covariance[2 * c] * cross_covariance[r] + inverse_covariance[2 * c + 1] * cross_covariance[2 + r];
  }
};

}  // namespace dlt_models

template <class T, class Group>
KV_HD void solve_dlt(dlt_models::Affine, Dlt<T> const& p, int64_t b, Group group) {
  dlt_models::Problem<2> const problem(p, b, group);
  dlt_models::AffineFit const map(problem, group);
  if (group.thread_rank() != 0) return;
  for (int r = 0; r < 2; ++r) {
    double const *const row = map.linear + 2 * r, *const mean = problem.image1.mean;
    double const result[] = {row[0], row[1], problem.image2.mean[r] - row[0] * mean[0] - row[1] * mean[1]};
    for (int k = 0; k < 3; ++k) p.result.set(9 * b + 3 * r + k, map.is_singular ? small::nan() : result[k]);
  }
  for (int k = 0; k < 3; ++k) p.result.set(9 * b + 6 + k, k == 2);
}

template <class T, class Group>
KV_HD void solve_dlt_vjp(dlt_models::Affine, Dlt<T> const& p, int64_t b, Group group) {
  dlt_models::Problem<2> const problem(p, b, group);
  dlt_models::AffineFit const map(problem, group);
  dlt_models::Weights const& weights = problem.weights;
  // Gradients to S, to C and to both means.
  double grad_map[4], grad_across[4], grad_square[4], grad_mean1[2] = {}, grad_mean2[2];
  for (int r = 0; r < 2; ++r) {
    double const shift = map.is_singular ? 0 : p.grad[9 * b + 3 * r + 2];
    grad_mean2[r] = shift;
    for (int c = 0; c < 2; ++c) {
      grad_mean1[c] -= map.is_singular ? 0 : shift * map.linear[2 * r + c];
      grad_map[2 * r + c] = map.is_singular ? 0 : p.grad[9 * b + 3 * r + c] - shift * problem.image1.mean[c];
    }
  }
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k)
      grad_across[2 * i + k] = map.is_singular ? 0
                                               : map.inverse_covariance[2 * i] * grad_map[2 * k] +
                                                     map.inverse_covariance[2 * i + 1] * grad_map[2 * k + 1];
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k)
      grad_square[2 * i + k] =
          map.is_singular ? 0 : -(grad_across[2 * i] * map.linear[k] + grad_across[2 * i + 1] * map.linear[2 + k]);

  // Of a correspondence: sets the gradients to both points, divided by its fraction, and returns that to the fraction.
  auto const row_gradients = [&](int64_t i, double* g1, double* g2) KV_INLINE {
    double x[2], y[2], grad_fraction = 0;
    problem.image1.centered(i, x);
    problem.image2.centered(i, y);
    for (int k = 0; k < 2; ++k) {
      double const by_square = grad_square[2 * k] * x[0] + grad_square[2 * k + 1] * x[1];
      double const by_across = grad_across[2 * k] * y[0] + grad_across[2 * k + 1] * y[1];
      grad_fraction += x[k] * (by_square + by_across);
      g1[k] = by_square + grad_square[k] * x[0] + grad_square[2 + k] * x[1] + by_across + grad_mean1[k];
      g2[k] = grad_across[k] * x[0] + grad_across[2 + k] * x[1] + grad_mean2[k];
      grad_fraction +=
          grad_mean1[k] * (x[k] + problem.image1.mean[k]) + grad_mean2[k] * (y[k] + problem.image2.mean[k]);
    }
    return grad_fraction;
  };
  double mean_grad = 0, g1[2], g2[2];
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads())
    mean_grad += weights.fraction(i) * row_gradients(i, g1, g2);
  mean_grad = group.sum(mean_grad);
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double const grad_fraction = row_gradients(i, g1, g2), fraction = weights.fraction(i);
    for (int k = 0; k < 2; ++k) {
      p.grad_points1.set(2 * (problem.image1.start + i) + k, fraction * g1[k]);
      p.grad_points2.set(2 * (problem.image2.start + i) + k, fraction * g2[k]);
    }
    bool const counts = weights.is_weighted() && weights[i] >= 0;
    p.grad_weights.set(b * p.count + i, counts ? (grad_fraction - mean_grad) / weights.total : 0);
  }
}

}  // namespace kv::geometry
