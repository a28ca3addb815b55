// Camera poses with the least weighted reprojection error, by Levenberg and Marquardt's method as in kvision's
// geometry/optim/_solver.py, from which the numbers come. A group of threads works on one problem.
#pragma once

#include "core/isa.h"
#include "geometry/liegroup/exponential_maps.h"
#include "geometry/quaternion.h"
#include "geometry/small_matrix.h"

namespace kv::geometry {

template <class T>
struct FitPoses {
  Reals start, points, pixels, camera, weights;  // (B, 7), (B, N, 3), (B, N, 2), (B or 1, 3, 3), (B, N) or none
  int64_t batch, count;
  bool one_camera;
  int max_iterations;
  double ftol, xtol, gtol, slack;  // slack: the relative increase of the cost that is rounding
  Reals poses, costs;              // (B, 7): quaternion (w, x, y, z) and translation; (B)
  bool* converged;                 // (B)
  int64_t* iterations;             // (B)
};

KV_KERNEL(fit_poses, FitPoses)

namespace pose_fits {

constexpr int kUnknowns = 6, kProducts = kUnknowns * (kUnknowns + 1) / 2;

// The lower triangle of J^T W J, J^T W r, and half the weighted sum of squares.
struct Normal {
  double hessian[kProducts], gradient[kUnknowns], cost;
};

KV_HD int entry(int i, int k) { return i * (i + 1) / 2 + k; }

template <class T, class Group>
KV_CALLED void linearize(FitPoses<T> const& p, int64_t b, double const* pose, Normal& normal, Group group) {
  double K[9], R[9], sums[kProducts + kUnknowns + 1] = {};
  for (int i = 0; i < 9; ++i) K[i] = p.camera[(p.one_camera ? 0 : 9 * b) + i];
  QuaternionToRotationMatrix::evaluate(pose, R, FormulaOptions{});
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    int64_t const at = b * p.count + i;
    double const w = p.weights.data ? p.weights[at] : 1;
    if (!(w > 0)) continue;
    double X[3], x[3], J[2][kUnknowns], r[2];
    for (int k = 0; k < 3; ++k) X[k] = p.points[3 * at + k];
    for (int k = 0; k < 3; ++k) x[k] = dot3(R + 3 * k, X) + pose[4 + k];
    double const inverse = 1 / x[2], u = x[0] * inverse, v = x[1] * inverse;
    for (int k = 0; k < 2; ++k) {
      double const fx = K[3 * k], fy = K[3 * k + 1];
      r[k] = fx * u + fy * v + K[3 * k + 2] - p.pixels[2 * at + k];
      J[k][0] = fx * inverse, J[k][1] = fy * inverse, J[k][2] = -(fx * u + fy * v) * inverse;
      cross3(x, J[k], J[k] + 3);  // exp(d) x is x + t + w x x
    }
    for (int k = 0; k < 2; ++k) {
      for (int m = 0; m < kUnknowns; ++m) {
        double const weighted = w * J[k][m];
        for (int n = 0; n <= m; ++n) sums[entry(m, n)] += weighted * J[k][n];
        sums[kProducts + m] += weighted * r[k];
      }
      sums[kProducts + kUnknowns] += 0.5 * w * r[k] * r[k];
    }
  }
  double const* const total = group.sums(sums);
  for (int k = 0; k < kProducts; ++k) normal.hessian[k] = total[k];
  for (int k = 0; k < kUnknowns; ++k) normal.gradient[k] = total[kProducts + k];
  normal.cost = total[kProducts + kUnknowns];
  group.sync();
}

// Solves (H + diag(added)) step = -g by Cholesky's method; false if the matrix is not positive definite.
KV_CALLED bool solve(Normal const& normal, double const* added, double* step) {
  double L[kProducts];
  for (int i = 0; i < kUnknowns; ++i)
    for (int k = 0; k <= i; ++k) {
      double x = normal.hessian[entry(i, k)] + (i == k ? added[i] : 0);
      for (int m = 0; m < k; ++m) x -= L[entry(i, m)] * L[entry(k, m)];
      if (i == k && !(x > 0)) return false;
      L[entry(i, k)] = i == k ? sqrt(x) : x / L[entry(k, k)];
    }
  for (int i = 0; i < kUnknowns; ++i) {
    double x = -normal.gradient[i];
    for (int k = 0; k < i; ++k) x -= L[entry(i, k)] * step[k];
    step[i] = x / L[entry(i, i)];
  }
  for (int i = kUnknowns - 1; i >= 0; --i) {
    for (int k = i + 1; k < kUnknowns; ++k) step[i] -= L[entry(k, i)] * step[k];
    step[i] /= L[entry(i, i)];
  }
  bool is_finite = true;
  for (int i = 0; i < kUnknowns; ++i) is_finite = is_finite && small::finite(step[i]);
  return is_finite;
}

// exp(step) pose.
KV_CALLED void move(double const* step, double const* pose, double* moved) {
  double motion[7], quaternions[8], R[9];
  Se3Exp::evaluate(step, motion, FormulaOptions{});
  for (int i = 0; i < 4; ++i) quaternions[i] = motion[i], quaternions[4 + i] = pose[i];
  QuaternionProduct::evaluate(quaternions, moved, FormulaOptions{});
  double square = 0;
  for (int i = 0; i < 4; ++i) square += moved[i] * moved[i];
  for (int i = 0; i < 4; ++i) moved[i] /= sqrt(square);
  QuaternionToRotationMatrix::evaluate(motion, R, FormulaOptions{});
  for (int i = 0; i < 3; ++i) moved[4 + i] = dot3(R + 3 * i, pose + 4) + motion[4 + i];
}

}  // namespace pose_fits

struct PoseFit {
  double cost;
  bool is_valid, is_done;  // whether the cost at the start is finite, and whether a tolerance was reached
  int iterations;
};

// Moves a pose to where its cost is least.
template <class T, class Group>
KV_HD PoseFit refine_pose(FitPoses<T> const& p, int64_t b, double* pose, Group group) {
  using namespace pose_fits;
  double candidate[7];
  Normal normal, next;
  linearize(p, b, pose, normal, group);
  bool const is_valid = small::finite(normal.cost);
  bool is_done = normal.cost == 0;
  double damping = 1e-3, growth = 4;
  int iterations = 0;
  for (; iterations < p.max_iterations && is_valid && !is_done; ++iterations) {
    double added[kUnknowns], step[kUnknowns], predicted = 0, length = 0, size = 0;
    bool is_stationary = true;
    for (int i = 0; i < kUnknowns; ++i) {
      double const norm = normal.hessian[entry(i, i)], slope = normal.gradient[i];
      added[i] = norm == 0 ? 1 : damping * norm;
      is_stationary = is_stationary && (slope < 0 ? -slope : slope) <= p.gtol * sqrt(norm) * sqrt(2 * normal.cost);
    }
    bool const is_solved = solve(normal, added, step);
    bool is_better = false;
    if (is_solved) {
      for (int i = 0; i < kUnknowns; ++i) {
        predicted += 0.5 * step[i] * (added[i] * step[i] - normal.gradient[i]);
        length += step[i] * step[i];
      }
      for (int i = 0; i < 7; ++i) size += pose[i] * pose[i];
      move(step, pose, candidate);
      linearize(p, b, candidate, next, group);
      is_better = next.cost <= normal.cost * (1 + p.slack);
      is_done = sqrt(length) <= p.xtol * (p.xtol + sqrt(size)) || predicted <= p.ftol * normal.cost || is_stationary;
    }
    if (is_better) {
      double const deviation = 2 * (normal.cost - next.cost) / predicted - 1;
      damping *= clamp(1 - deviation * deviation * deviation, 1.0 / 9, 1.0);
      growth = 4;
      normal = next;
      for (int i = 0; i < 7; ++i) pose[i] = candidate[i];
    } else {
      damping *= growth;
      growth = min(4 * growth, 1e6);
    }
    damping = clamp(damping, 1e-15, 1e15);
  }
  return {normal.cost, is_valid, is_done, iterations};
}

template <class T, class Group>
KV_HD void fit_pose(FitPoses<T> const& p, int64_t b, Group group) {
  double pose[7];
  for (int i = 0; i < 7; ++i) pose[i] = p.start[7 * b + i];
  PoseFit const fit = refine_pose(p, b, pose, group);
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 7; ++i) p.poses.set(7 * b + i, fit.is_valid ? pose[i] : small::nan());
  p.costs.set(b, fit.is_valid ? fit.cost : small::nan());
  p.converged[b] = fit.is_done && fit.is_valid;
  p.iterations[b] = fit.iterations;
}

}  // namespace kv::geometry
