// Direct linear transformation (DLT): estimates a model from correspondences by linear least squares, and its gradient.
// One pass over the correspondences sums a small matrix.
//
//   n = s (p - m)        normalized points of an image. m is their weighted mean, and s = sqrt(D) / (d + eps) scales
//                        their mean distance d from it to sqrt(D), for points of D coordinates.
//   M = sum w r r^T      over the rows r of all correspondences. h is the eigenvector of M's smallest eigenvalue.
//
// A homography maps n1 = (u, v, 1) to (x, y) = n2, a camera maps points of space n1 = (u, v, w, 1):
//   r = (0, -n1, y n1), (n1, 0, -x n1). The result is T2^-1 h T1 in pixels.
// A homography of segments maps both ends n1 of a segment to the line l = (x, y, 1) x (x', y', 1) through the ends of
// the other one, l^T h n1 = 0:
//   r = the products of l and n1.
// A fundamental matrix has n2^T F n1 = 0 for n2 = (x, y, 1):
//   r = the products of n2 and n1. The result is T2^T F T1, where F is the matrix of rank 2 that is nearest to h.
//
// An affine map needs no eigenvector, but has the same interface: A (p1 - m1) is fitted to p2 - m2 by least squares.
//
// Homographies and fundamental matrices are divided by their last entry unless that is 0. A camera becomes a pose: its
// image points are K^-1 (x, y, 1). The columns of its rotation are made orthogonal one after the other, and the first
// one determines the scale.
#pragma once

#include "geometry/solvers/dlt_affine.h"
#include "geometry/solvers/dlt_fundamental.h"
#include "geometry/solvers/dlt_homography.h"
#include "geometry/solvers/dlt_pose.h"

namespace kv::geometry {

template <class Model, class T, class Group>
KV_HD void solve_dlt(Model, Dlt<T> const& p, int64_t b, Group group) {
  constexpr int n = Model::kUnknowns;
  dlt_models::Problem<Model::kAxes, Model::kPoints> const problem(p, b, group);
  typename Group::template SharedStorage<small::EigenSpace<n>> storage;
  small::EigenSpace<n>& space = storage.get();
  bool const is_solvable = Model::is_solvable(p, problem, group);
  Model::normal_matrix(problem, group, space.matrix);
  auto const warp = group.first_warp();
  if (warp.is_idle()) return;
  small::smallest_eigenvector<n>(space, warp);
  if (group.thread_rank() != 0) return;
  double f[n], denormalize_right[n], result[n];
  Model::constrain(space.v, f);
  problem.denormalize_right(f, denormalize_right);
  Model::denormalize_left(problem.image2, denormalize_right, f);
  Model::finish(f, result);
  for (int i = 0; i < n; ++i) p.result.set(n * b + i, is_solvable ? result[i] : small::nan());
}

template <class Model, class T, class Group>
KV_HD void solve_dlt_vjp(Model, Dlt<T> const& p, int64_t b, Group group) {
  constexpr int n = Model::kUnknowns, D = Model::kAxes, kPoints = Model::kPoints;
  dlt_models::Problem<D, kPoints> const problem(p, b, group);
  dlt_models::Image<D> const& image1 = problem.image1;
  dlt_models::Image<2> const& image2 = problem.image2;
  dlt_models::ImageGradients<D> grad_image1;
  dlt_models::ImageGradients<2> grad_image2;
  dlt_models::Weights const& weights = problem.weights;
  typename Group::template SharedStorage<small::EigenSpace<n>> storage;
  small::EigenSpace<n>& space = storage.get();
  double const *const h = space.v, *const u = space.u;
  bool const is_solvable = Model::is_solvable(p, problem, group);
  Model::normal_matrix(problem, group, space.matrix);
  auto const warp = group.first_warp();
  if (!warp.is_idle()) small::smallest_eigenvector<n>(space, warp);
  if (group.thread_rank() == 0) {
    double f[n], denormalize_right[n], denormalize_left[n], g[n];
    Model::constrain(h, f);
    problem.denormalize_right(f, denormalize_right);
    Model::denormalize_left(image2, denormalize_right, denormalize_left);
    for (int i = 0; i < n; ++i) g[i] = is_solvable ? p.grad[n * b + i] : 0;
    Model::finish_vjp(denormalize_left, g);
    Model::denormalize_left_vjp(image2, denormalize_right, g, grad_image2);
    problem.denormalize_right_vjp(f, g, grad_image1);
    Model::constrain_vjp(h, g);
    for (int i = 0; i < n; ++i) space.g[i] = g[i];
  }
  if (!warp.is_idle()) {
    warp.sync();
    small::smallest_eigenvector_vjp<n>(space, warp);
  }
  group.sync();

  // Sets the gradients to the normalized points of correspondence i, and returns that to its weight.
  auto const row_gradients = [&](int64_t i, double* g1, double* g2) KV_INLINE {
    double n1[kPoints * (D + 1)], n2[kPoints * 3];
    for (int e = 0; e < kPoints; ++e) problem.normalized(kPoints * i + e, n1 + (D + 1) * e, n2 + 3 * e);
    return Model::row_vjp(weights[i], u, h, n1, n2, g1, g2);
  };
  double g1[kPoints * D], g2[kPoints * 2];
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    row_gradients(i, g1, g2);
    for (int e = 0; e < kPoints; ++e) {
      grad_image1.add(image1, kPoints * i + e, problem.fraction(i), g1 + D * e);
      grad_image2.add(image2, kPoints * i + e, problem.fraction(i), g2 + 2 * e);
    }
  }
  grad_image1.finish(image1, group);
  grad_image2.finish(image2, group);

  // Gradients to points and to fractions; the fractions sum to 1.
  double mean_grad = 0, grad_camera[6] = {};
  auto const grad_fraction = [&](int64_t i) KV_INLINE {
    double sum = 0;
    for (int64_t e = kPoints * i; e < kPoints * (i + 1); ++e)
      sum += grad_image1.grad_fraction(image1, e) + grad_image2.grad_fraction(image2, e);
    return sum / kPoints;
  };
  if (weights.is_weighted()) {
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads())
      mean_grad += weights.fraction(i) * grad_fraction(i);
    mean_grad = group.sum(mean_grad);
  }
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double grad_weight = row_gradients(i, g1, g2);
    for (int e = 0; e < kPoints; ++e) {
      grad_image1.grad_point(image1, kPoints * i + e, problem.fraction(i), g1 + D * e);
      grad_image2.grad_point(image2, kPoints * i + e, problem.fraction(i), g2 + 2 * e);
    }
    if (weights.is_weighted() && weights[i] >= 0) grad_weight += (grad_fraction(i) - mean_grad) / weights.total;
    if (weights.squared && weights.weights.data) grad_weight *= 2 * weights.weights[weights.first + i];
    if (image2.calibration.camera.data) {
      double pixel[2], xy[2];
      image2.point(i, xy);
      for (int k = 0; k < 2; ++k) pixel[k] = image2.points[2 * (image2.start + i) + k];
      image2.calibration.vjp(pixel, xy, g2, grad_camera);
    }
    for (int k = 0; k < kPoints * D; ++k) p.grad_points1.set(D * (image1.start + kPoints * i) + k, g1[k]);
    for (int k = 0; k < kPoints * 2; ++k) p.grad_points2.set(2 * (image2.start + kPoints * i) + k, g2[k]);
    p.grad_weights.set(b * p.count + i, grad_weight);
  }
  if (!image2.calibration.camera.data) return;
  constexpr int entries[] = {0, 1, 2, 4, 5, 8};
  for (double& x : grad_camera) x = group.sum(x);
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 9; ++i) p.grad_camera.set(9 * b + i, 0);
  for (int i = 0; i < 6; ++i) p.grad_camera.set(9 * b + entries[i], grad_camera[i]);
}

template <class T, class Group>
KV_HD void normalize_problem(NormalizedPoints<T> const& p, int64_t b, Group group) {
  dlt_models::Weights const weights(p.weights, b, p.count, false, group);
  dlt_models::Image<2> image{p.points, b * p.count, {}, {}, 0, 0};
  image.normalize<1>(weights, p.eps, group);
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double at[2];
    image.centered(i, at);
    for (int k = 0; k < 2; ++k) p.normalized.set(2 * (image.start + i) + k, image.scale * at[k]);
  }
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 9; ++i) {
    double const shift = i % 3 == 2 && i < 6 ? -image.scale * image.mean[i / 3] : 0;
    p.matrix.set(9 * b + i, i == 8 ? 1 : i % 4 == 0 ? image.scale : shift);
  }
}

template <class T, class Group>
KV_HD void normalize_problem_vjp(NormalizedPoints<T> const& p, int64_t b, Group group) {
  dlt_models::Weights const weights(p.weights, b, p.count, false, group);
  dlt_models::Image<2> image{p.points, b * p.count, {}, {}, 0, 0};
  image.normalize<1>(weights, p.eps, group);
  dlt_models::ImageGradients<2> gradients;
  auto const read_grad = [&](int64_t i, double* g) KV_INLINE {
    for (int k = 0; k < 2; ++k) g[k] = p.grad[2 * (image.start + i) + k];
  };
  double g[2], mean_grad = 0;
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    read_grad(i, g);
    gradients.add(image, i, weights.fraction(i), g);
  }
  if (group.thread_rank() == 0)
    for (int k = 0; k < 2; ++k) {
      double const shift = p.grad_matrix[9 * b + 3 * k + 2];
      gradients.scale += p.grad_matrix[9 * b + 4 * k] - shift * image.mean[k];
      gradients.mean[k] -= shift * image.scale;
    }
  gradients.finish(image, group);
  if (weights.is_weighted()) {
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads())
      mean_grad += weights.fraction(i) * gradients.grad_fraction(image, i);
    mean_grad = group.sum(mean_grad);
  }
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    read_grad(i, g);
    gradients.grad_point(image, i, weights.fraction(i), g);
    for (int k = 0; k < 2; ++k) p.grad_points.set(2 * (image.start + i) + k, g[k]);
    bool const counts = weights.is_weighted() && weights[i] >= 0;
    p.grad_weights.set(b * p.count + i, counts ? (gradients.grad_fraction(image, i) - mean_grad) / weights.total : 0);
  }
}

// Calls f with the functions of a model.
template <class F>
KV_HD void dispatch_model(DltModel model, F f) {
  switch (model) {
    case DltModel::homography:
      return f(dlt_models::Homography{});
    case DltModel::lines:
      return f(dlt_models::Lines{});
    case DltModel::fundamental:
      return f(dlt_models::Fundamental{});
    case DltModel::pose:
      return f(dlt_models::Pose{});
    default:
      return f(dlt_models::Affine{});
  }
}

}  // namespace kv::geometry
