// Bundles: poses of cameras and points in space with the least reprojection error, by Levenberg and Marquardt's method
// as in kvision's geometry/optim/_solver.py, from which the numbers come. With damping D, and J and r of an observation
// weighted by its robust loss, the normal equations
//
//   [U + D  W    ] [x]      [g]    U = sum of Jc^T Jc of a camera (6 x 6),  g = sum of Jc^T r
//   [W^T    V + D] [y]  = - [h],   V = sum of Jp^T Jp of a point (3 x 3),   h = sum of Jp^T r,   W = Jc^T Jp (6 x 3)
//
// are solved for the cameras by the Schur complement, a dense matrix, and then for the points. A step has these phases,
// each a kernel of its own, which the glue calls in turn:
//
//   start      the state of a problem, from the arguments
//   points     W of each observation; h, V and (V + D)^-1 of each point
//   cameras    six rows of the Schur complement S = U + D - sum of W (V + D)^-1 W^T and of its right side, for each
//   camera factor     S = L L^T; the right side is one more row, of which L^-1 times it is left solve      x, and the
//   poses that it leads to evaluate   y, the points that it leads to, and the cost there accept     keeps what is
//   better and changes the damping finish     the results
//
// Observations are in the order of their points, and those of a point in the order of their cameras. Nothing is stored
// for a pair of observations, only W for each; sums have one order: the same bits every run.
#pragma once

#include "core/isa.h"
#include "geometry/optim/fit_poses.h"
#include "geometry/optim/robust_losses.h"

namespace kv::geometry {

// Six rows of the Schur complement fit into the shared memory of any GPU.
constexpr int kMaxBundleCameras = 200;

struct BundleState {
  double cost, damping, growth;
  int32_t current, is_done, is_valid, iterations;  // current: which of the two estimates is the best one
};

template <class T>
struct FitBundle {
  Reals start_poses, start_points;  // (B, C, 7): quaternion (w, x, y, z) and translation; (B, K, 3)
  Reals pixels, camera, weights;    // (B, N, 2), (B or 1, 3, 3), (B, N) or none
  int32_t const *cameras, *points;  // (N): what an observation sees, in ascending order
  int32_t const* by_camera;         // (N): observations in the order of their cameras
  int32_t const *of_camera,
      *of_point;  // (C + 1), (K + 1): where those of a camera begin in by_camera, those of a point
  int64_t batch, count, num_cameras, num_points;
  bool one_camera;
  RobustLoss loss;
  double squared_scale, ftol, xtol, gtol, slack;  // slack: the relative increase of the cost that is rounding
  bool is_first;                                  // evaluate and accept the start itself

  BundleState* state;                // (B)
  double *poses, *positions;         // the best estimate and the next one: (2, B, C, 7), (2, B, K, 3)
  double* camera_terms;              // (B, C, 18): gradient, squared norms of the columns, step
  double* point_terms;               // (B, K, 12): (V + D)^-1, gradient, squared norms of the columns
  double *camera_sums, *point_sums;  // (B, C, 4), (B, K, 5): what `accept` adds up
  Reals couplings;                   // (B, N, 6, 3): W
  double *matrix, *diagonal;         // (B, pitch, pitch), and on CUDA (B, pitch, 32): S, and tiles of its factor
  int64_t pitch;                     // 6 C + 1, rounded up to a multiple of 32

  Reals poses_out, points_out, costs;  // (B, C, 7), (B, K, 3), (B)
  bool* converged;                     // (B)
  int64_t* iterations;                 // (B)

  KV_HD int64_t size() const { return 6 * num_cameras; }
  // Indices out of range are those at the ends, so that no memory is read that is not there.
  KV_HD static int64_t bounded(int64_t i, int64_t size) { return i < 0 ? 0 : i < size ? i : size - 1; }
  KV_HD int64_t camera_of(int64_t at) const { return bounded(cameras[at], num_cameras); }
  KV_HD int64_t point_of(int64_t at) const { return bounded(points[at], num_points); }
  KV_HD int64_t in_order(int64_t slot) const { return bounded(by_camera[slot], count); }
  KV_HD int64_t first_of_camera(int64_t c) const { return bounded(of_camera[c], count + 1); }
  KV_HD int64_t first_of_point(int64_t k) const { return bounded(of_point[k], count + 1); }
  // Whether every observation sees a camera and a point.
  KV_HD bool is_complete() const {
    return of_camera[0] == 0 && of_camera[num_cameras] == count && of_point[0] == 0 && of_point[num_points] == count;
  }
  KV_HD bool is_idle(int64_t b) const { return !is_first && (state[b].is_done || !state[b].is_valid); }
  // The best estimate, 0, or the next one, 1.
  KV_HD int64_t estimate(int64_t b, int next) const { return (is_first ? 0 : state[b].current) ^ next; }
  KV_HD double* pose(int64_t b, int64_t c, int next) const {
    return poses + 7 * ((estimate(b, next) * batch + b) * num_cameras + c);
  }
  KV_HD double* position(int64_t b, int64_t k, int next) const {
    return positions + 3 * ((estimate(b, next) * batch + b) * num_points + k);
  }
  KV_HD double* row(int64_t b, int64_t i) const { return matrix + (b * pitch + i) * pitch; }
  KV_HD double damping(int64_t b, double norm) const { return norm == 0 ? 1 : state[b].damping * norm; }
};

KV_KERNEL(bundle_start, FitBundle)
KV_KERNEL(bundle_points, FitBundle)
KV_KERNEL(bundle_cameras, FitBundle)
KV_KERNEL(bundle_factor, FitBundle)
KV_KERNEL(bundle_solve, FitBundle)
KV_KERNEL(bundle_evaluate, FitBundle)
KV_KERNEL(bundle_accept, FitBundle)
KV_KERNEL(bundle_finish, FitBundle)

namespace bundles {

constexpr int kTile = 32;     // of the Schur complement
constexpr int kInFlight = 4;  // products of couplings that a thread has at once

// --- observations ----------------------------------------------------------------------------------------------------

// An error in pixels, its derivatives along steps of the camera and of the point, and what its robust loss makes of
// them.
struct Observation {
  double r[2], to_pose[2][6], to_point[2][3];
  double slope, bend;  // weight * rho', and the factor of r r^T in the Hessian
};

// The error of an observation at a pose and a point, and the point before the camera; false without a weight.
template <class T>
KV_HD bool project(FitBundle<T> const& p, int64_t b, int64_t at, double const* pose, double const* X, double* R,
                   double* x, double* r, double& weight) {
  weight = p.weights.data ? p.weights[b * p.count + at] : 1;
  if (!(weight > 0)) return false;
  QuaternionToRotationMatrix::evaluate(pose, R, FormulaOptions{});
  for (int k = 0; k < 3; ++k) x[k] = dot3(R + 3 * k, X) + pose[4 + k];
  double const u = x[0] / x[2], v = x[1] / x[2];
  int64_t const K = p.one_camera ? 0 : 9 * b;
  for (int k = 0; k < 2; ++k)
    r[k] = p.camera[K + 3 * k] * u + p.camera[K + 3 * k + 1] * v + p.camera[K + 3 * k + 2] -
           p.pixels[2 * (b * p.count + at) + k];
  return true;
}

template <class T>
KV_HD bool observe(FitBundle<T> const& p, int64_t b, int64_t at, double const* pose, double const* X, Observation& o) {
  double R[9], x[3], weight;
  if (!project(p, b, at, pose, X, R, x, o.r, weight)) return false;
  double const inverse = 1 / x[2], u = x[0] * inverse, v = x[1] * inverse;
  int64_t const K = p.one_camera ? 0 : 9 * b;
  for (int k = 0; k < 2; ++k) {
    double const fx = p.camera[K + 3 * k], fy = p.camera[K + 3 * k + 1];
    double* const J = o.to_pose[k];
    J[0] = fx * inverse, J[1] = fy * inverse, J[2] = -(fx * u + fy * v) * inverse;
    cross3(x, J, J + 3);  // exp(d) x is x + t + w x x
    for (int i = 0; i < 3; ++i) o.to_point[k][i] = J[0] * R[i] + J[1] * R[3 + i] + J[2] * R[6 + i];
  }
  double const s = o.r[0] * o.r[0] + o.r[1] * o.r[1];
  LossValue const loss = robust_loss(p.loss, s, p.squared_scale);
  double const bend = 2 * loss.curvature;
  o.slope = weight * loss.slope;
  o.bend = weight * (s > 0 ? max(bend, -loss.slope / s) : bend);  // negative curvature along r counts as 0
  return true;
}

// The weighted derivatives: slope J + bend r (r^T J).
template <int N>
KV_HD void weigh(Observation const& o, double const (&J)[2][N], double (&weighted)[2][N]) {
  for (int i = 0; i < N; ++i) {
    double const along = o.bend * (o.r[0] * J[0][i] + o.r[1] * J[1][i]);
    for (int k = 0; k < 2; ++k) weighted[k][i] = o.slope * J[k][i] + along * o.r[k];
  }
}

// Adds the lower triangle of J^T W J, J^T W r and the squared norms of the columns to sums.
template <int N>
KV_HD void add_squares(Observation const& o, double const (&J)[2][N], double const (&weighted)[2][N], double* sums) {
  constexpr int kTriangle = N * (N + 1) / 2;
  for (int i = 0; i < N; ++i) {
    for (int k = 0; k <= i; ++k) sums[pose_fits::entry(i, k)] += weighted[0][i] * J[0][k] + weighted[1][i] * J[1][k];
    sums[kTriangle + i] += o.slope * (J[0][i] * o.r[0] + J[1][i] * o.r[1]);
    sums[kTriangle + N + i] += o.slope * (J[0][i] * J[0][i] + J[1][i] * J[1][i]);
  }
}

// The inverse of a symmetric 3 x 3 matrix, as both are: xx, xy, yy, xz, yz, zz.
KV_HD void invert_symmetric(double const* m, double* inverse) {
  double const a = m[2] * m[5] - m[4] * m[4], b = m[3] * m[4] - m[1] * m[5], c = m[1] * m[4] - m[2] * m[3];
  double const scale = 1 / (m[0] * a + m[1] * b + m[3] * c);
  inverse[0] = scale * a, inverse[1] = scale * b, inverse[2] = scale * (m[0] * m[5] - m[3] * m[3]);
  inverse[3] = scale * c, inverse[4] = scale * (m[1] * m[3] - m[0] * m[4]);
  inverse[5] = scale * (m[0] * m[2] - m[1] * m[1]);
}

KV_HD void multiply_symmetric(double const* m, double const* x, double* y) {
  y[0] = m[0] * x[0] + m[1] * x[1] + m[3] * x[2];
  y[1] = m[1] * x[0] + m[2] * x[1] + m[4] * x[2];
  y[2] = m[3] * x[0] + m[4] * x[1] + m[5] * x[2];
}

KV_HD double numeric(double x) { return small::finite(x) ? x : 0; }

// --- phases ----------------------------------------------------------------------------------------------------------

// Camera or point `i` of a problem.
template <class T>
KV_HD void start(FitBundle<T> const& p, int64_t b, int64_t i) {
  bool const is_camera = i < p.num_cameras;
  int64_t const k = is_camera ? i : i - p.num_cameras, row = b * (is_camera ? p.num_cameras : p.num_points) + k;
  for (int next = 0; next < 2; ++next)
    if (is_camera)
      for (int j = 0; j < 7; ++j) p.pose(b, k, next)[j] = p.start_poses[7 * row + j];
    else
      for (int j = 0; j < 3; ++j) p.position(b, k, next)[j] = p.start_points[3 * row + j];
}

template <class T, class Group>
KV_HD void linearize_point(FitBundle<T> const& p, int64_t b, int64_t k, Group group) {
  if (p.is_idle(b)) return;
  double sums[12] = {}, X[3];
  for (int i = 0; i < 3; ++i) X[i] = p.position(b, k, 0)[i];
  int64_t const last = p.first_of_point(k + 1);
  for (int64_t at = p.first_of_point(k) + group.thread_rank(); at < last; at += group.num_threads()) {
    Observation o;
    double weighted[2][3] = {};
    bool const counts = observe(p, b, at, p.pose(b, p.camera_of(at), 0), X, o);
    if (counts) {
      weigh(o, o.to_point, weighted);
      add_squares(o, o.to_point, weighted, sums);
    }
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 3; ++j) {
        double const w = counts ? o.to_pose[0][i] * weighted[0][j] + o.to_pose[1][i] * weighted[1][j] : 0;
        p.couplings.set(18 * (b * p.count + at) + 3 * i + j, w);
      }
  }
  double const* const total = group.sums(sums);
  if (group.thread_rank() != 0) return;
  double* const terms = p.point_terms + 12 * (b * p.num_points + k);
  double V[6];
  for (int i = 0; i < 6; ++i) V[i] = total[i];
  for (int i = 0; i < 3; ++i) V[pose_fits::entry(i, i)] += p.damping(b, total[9 + i]);
  invert_symmetric(V, terms);
  for (int i = 0; i < 6; ++i) terms[6 + i] = total[6 + i];
}

// The own part of the rows of a camera: the lower triangle of U + D (21) and the right side (6), for all threads.
template <class T, class Group>
KV_HD void linearize_camera(FitBundle<T> const& p, int64_t b, int64_t c, double* own, Group group) {
  double sums[39] = {}, pose[7];  // U, gradient, squared norms, W (V + D)^-1 h
  for (int i = 0; i < 7; ++i) pose[i] = p.pose(b, c, 0)[i];
  int64_t const last = p.first_of_camera(c + 1);
  for (int64_t slot = p.first_of_camera(c) + group.thread_rank(); slot < last; slot += group.num_threads()) {
    int64_t const at = p.in_order(slot), k = p.point_of(at);
    Observation o;
    if (!observe(p, b, at, pose, p.position(b, k, 0), o)) continue;
    double weighted[2][6], y[3];
    weigh(o, o.to_pose, weighted);
    add_squares(o, o.to_pose, weighted, sums);
    double const* const terms = p.point_terms + 12 * (b * p.num_points + k);
    multiply_symmetric(terms, terms + 6, y);
    int64_t const W = 18 * (b * p.count + at);
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 3; ++j) sums[33 + i] += p.couplings[W + 3 * i + j] * y[j];
  }
  double const* const total = group.sums(sums);
  for (int i = 0; i < 21; ++i) own[i] = total[i];
  for (int i = 0; i < 6; ++i) {
    own[pose_fits::entry(i, i)] += p.damping(b, total[27 + i]);
    own[21 + i] = total[33 + i] - total[21 + i];
  }
  double* const terms = p.camera_terms + 18 * (b * p.num_cameras + c);
  for (int i = group.thread_rank(); i < 12; i += group.num_threads()) terms[i] = total[21 + i];
}

// Adds W (V + D)^-1 W^T of observations first, first + step, ... of a camera to its six rows, up to its own columns.
// The threads of a group take the products of an observation in turns, several at once so that their loads overlap; y
// is memory of theirs for 18 numbers. A camera may see a point several times, but threads never add to one entry at
// once: there are 36 for each observation, and at most 32 threads.
template <class S, class T, class Group>
KV_HD void add_couplings(FitBundle<T> const& p, S const* couplings, int64_t b, int64_t c, int64_t first, int64_t step,
                         double* rows, int64_t pitch, double* y, Group group) {
  int64_t const last = p.first_of_camera(c + 1);
  for (int64_t slot = p.first_of_camera(c) + first; slot < last; slot += step) {
    int64_t const at = p.in_order(slot), k = p.point_of(at), W = 18 * (b * p.count + at);
    double const* const inverse = p.point_terms + 12 * (b * p.num_points + k);
    for (int t = group.thread_rank(); t < 18; t += group.num_threads()) {
      int const i = t / 3, j = t % 3;
      double sum = 0;
      for (int m = 0; m < 3; ++m)
        sum += double(couplings[W + 3 * i + m]) * inverse[m < j ? pose_fits::entry(j, m) : pose_fits::entry(m, j)];
      y[t] = sum;
    }
    group.sync();
    // Those of other cameras come before the observation, as all are sorted.
    int64_t const begin = p.first_of_point(k);
    int64_t end = at + 1;
    while (end < p.first_of_point(k + 1) && p.camera_of(end) == c) ++end;
    int const products = int(36 * (end - begin)), threads = group.num_threads();
    for (int first_product = 0; first_product < products; first_product += kInFlight * threads) {
      double values[kInFlight];
      int64_t entries[kInFlight];
#pragma unroll
      for (int u = 0; u < kInFlight; ++u) {
        int const own = first_product + u * threads + group.thread_rank(), t = own < products ? own : products - 1;
        int const i = t % 36 / 6, j = t % 6;  // without branches, around which no load would be moved
        int64_t const other = begin + t / 36, column = p.camera_of(other);
        S const* const V = couplings + 18 * (b * p.count + other) + 3 * j;
        values[u] = y[3 * i] * double(V[0]) + y[3 * i + 1] * double(V[1]) + y[3 * i + 2] * double(V[2]);
        entries[u] = own < products && column <= c ? i * pitch + 6 * column + j : -1;
      }
#pragma unroll
      for (int u = 0; u < kInFlight; ++u) {
        if (entries[u] >= 0) rows[entries[u]] += values[u];
        group.sync();
      }
    }
    group.sync();
  }
}

// The same of couplings in their type, for all of whose loads it is asked once.
template <class T, class Group>
KV_HD void add_couplings(FitBundle<T> const& p, int64_t b, int64_t c, int64_t first, int64_t step, double* rows,
                         int64_t pitch, double* y, Group group) {
  if (p.couplings.is_double)
    add_couplings(p, static_cast<double const*>(p.couplings.data), b, c, first, step, rows, pitch, y, group);
  else
    add_couplings(p, static_cast<float const*>(p.couplings.data), b, c, first, step, rows, pitch, y, group);
}

// The pose that the step of a camera leads to, and its share of the sums: the predicted decrease of the cost, the
// squared lengths of step and pose, and the number of columns that are not orthogonal to the residuals.
template <class T>
KV_CALLED void move_camera(FitBundle<T> const& p, int64_t b, int64_t c) {
  double const* const terms = p.camera_terms + 18 * (b * p.num_cameras + c);
  double const* const pose = p.pose(b, c, 0);
  double *const sums = p.camera_sums + 4 * (b * p.num_cameras + c), bound = p.gtol * sqrt(2 * p.state[b].cost);
  double step[6], moved[7];
  for (int i = 0; i < 4; ++i) sums[i] = 0;
  for (int i = 0; i < 6; ++i) {
    double const gradient = terms[i], norm = terms[6 + i], x = terms[12 + i];
    step[i] = numeric(x);
    sums[0] += 0.5 * x * (p.damping(b, norm) * x - gradient);
    sums[1] += step[i] * step[i];
    sums[3] += !(small::magnitude(gradient) <= bound * sqrt(norm));
  }
  for (int i = 0; i < 7; ++i) sums[2] += pose[i] * pose[i];
  pose_fits::move(step, pose, moved);
  for (int i = 0; i < 7; ++i) p.pose(b, c, 1)[i] = moved[i];
}

// The same of a point, whose step follows from those of the cameras, and first the cost of its observations.
template <class T, class Group>
KV_HD void evaluate_point(FitBundle<T> const& p, int64_t b, int64_t k, Group group) {
  if (p.is_idle(b)) return;
  int64_t const first = p.first_of_point(k) + group.thread_rank(), last = p.first_of_point(k + 1);
  double const* const terms = p.point_terms + 12 * (b * p.num_points + k);
  double X[3], parts[5] = {};
  for (int i = 0; i < 3; ++i) X[i] = p.position(b, k, 0)[i], parts[3] += X[i] * X[i];
  if (!p.is_first) {
    double sums[3] = {}, step[3];
    for (int64_t at = first; at < last; at += group.num_threads()) {
      double const* const x = p.camera_terms + 18 * (b * p.num_cameras + p.camera_of(at)) + 12;
      int64_t const W = 18 * (b * p.count + at);
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 3; ++j) sums[j] += p.couplings[W + 3 * i + j] * x[i];
    }
    double const* const total = group.sums(sums);
    double rest[3];
    for (int i = 0; i < 3; ++i) rest[i] = terms[6 + i] + total[i];
    multiply_symmetric(terms, rest, step);
    double const bound = p.gtol * sqrt(2 * p.state[b].cost);
    for (int i = 0; i < 3; ++i) {
      double const x = -step[i], gradient = terms[6 + i], norm = terms[9 + i];
      parts[1] += 0.5 * x * (p.damping(b, norm) * x - gradient);
      parts[2] += numeric(x) * numeric(x);
      parts[4] += !(small::magnitude(gradient) <= bound * sqrt(norm));
      X[i] += numeric(x);
    }
  }
  double cost[1] = {};
  for (int64_t at = first; at < last; at += group.num_threads()) {
    double R[9], x[3], r[2], weight;
    if (!project(p, b, at, p.pose(b, p.camera_of(at), 1), X, R, x, r, weight)) continue;
    cost[0] += 0.5 * weight * robust_loss(p.loss, r[0] * r[0] + r[1] * r[1], p.squared_scale).rho;
  }
  parts[0] = *group.sums(cost);
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 3; ++i) p.position(b, k, 1)[i] = X[i];
  for (int i = 0; i < 5; ++i) p.point_sums[5 * (b * p.num_points + k) + i] = parts[i];
}

template <class T, class Group>
KV_HD void accept(FitBundle<T> const& p, int64_t b, Group group) {
  if (p.is_idle(b)) return;
  double sums[5] = {};
  for (int64_t k = group.thread_rank(); k < p.num_points; k += group.num_threads())
    for (int i = 0; i < 5; ++i) sums[i] += p.point_sums[5 * (b * p.num_points + k) + i];
  if (!p.is_first)
    for (int64_t c = group.thread_rank(); c < p.num_cameras; c += group.num_threads())
      for (int i = 0; i < 4; ++i) sums[1 + i] += p.camera_sums[4 * (b * p.num_cameras + c) + i];
  double const* const total = group.sums(sums);
  if (group.thread_rank() != 0) return;
  double const cost = total[0], predicted = total[1];
  BundleState& state = p.state[b];
  if (p.is_first) {
    state = {cost, 1e-3, 4, 0, cost == 0, small::finite(cost) && p.is_complete(), 0};
    return;
  }
  ++state.iterations;
  if (small::finite(predicted)) {
    bool const is_small = sqrt(total[2]) <= p.xtol * (p.xtol + sqrt(total[3]));
    state.is_done = is_small || predicted <= p.ftol * state.cost || total[4] == 0;
  }
  if (small::finite(predicted) && cost <= state.cost * (1 + p.slack)) {
    double const deviation = 2 * (state.cost - cost) / predicted - 1;
    state.damping *= clamp(1 - deviation * deviation * deviation, 1.0 / 9, 1.0);
    state.growth = 4;
    state.cost = cost;
    state.current ^= 1;
  } else {
    state.damping *= state.growth;
    state.growth = min(4 * state.growth, 1e6);
  }
  state.damping = clamp(state.damping, 1e-15, 1e15);
}

template <class T>
KV_HD void finish(FitBundle<T> const& p, int64_t b, int64_t i) {
  BundleState const& state = p.state[b];
  bool const is_camera = i < p.num_cameras;
  int64_t const k = is_camera ? i : i - p.num_cameras, row = b * (is_camera ? p.num_cameras : p.num_points) + k;
  for (int j = 0; j < (is_camera ? 7 : 3); ++j)
    if (is_camera)
      p.poses_out.set(7 * row + j, state.is_valid ? p.pose(b, k, 0)[j] : small::nan());
    else
      p.points_out.set(3 * row + j, state.is_valid ? p.position(b, k, 0)[j] : small::nan());
  if (i != 0) return;
  p.costs.set(b, state.is_valid ? state.cost : small::nan());
  p.converged[b] = state.is_valid && state.is_done;
  p.iterations[b] = state.iterations;
}

}  // namespace bundles
}  // namespace kv::geometry
