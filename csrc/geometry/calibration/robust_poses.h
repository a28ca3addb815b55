// Camera poses from correspondences of which many are wrong: of many hypotheses the best one, fitted by
// sigma-consensus++ as in kvision's geometry/solvers/_sigma_consensus.py, from which the numbers come. With e the
// squared error in pixels and x = x_end e / reach^2 the weight and the gain of a correspondence are
//
//   w = exp(-x) - exp(-x_end)      w + exp(-x_end) (x - x_end)     both 0 from x_end on
//
// The score of a pose is the sum of gains. A group of threads works on one problem.
#pragma once

#include "core/isa.h"
#include "geometry/optim/fit_poses.h"
#include "geometry/residuals.h"

namespace kv::geometry {

template <class T>
struct RobustPoses {
  Reals hypotheses;         // (B, S, 3, 4), NaN for missing ones
  bool const* mask;         // (B, N): the correspondences that exist; null for all
  FitPoses<T> fit;          // of one round; its weights are those of the result, its poses the best ones
  int64_t num_hypotheses;   // S
  int rounds;               // the most fits
  double threshold, reach;  // of inliers, and of correspondences that a fit uses, in pixels
  bool* inliers;            // (B, N); none on one line
};

KV_KERNEL(robust_poses, RobustPoses)

namespace robust_pose {

constexpr double kEnd = 11.345 / 2;  // x_end: 99% of the squared norms of three normal numbers are below its double
constexpr double kRest = 0.003439256378518648;  // exp(-x_end)
constexpr double kTolerance = 1e-5;             // the relative increase of a score that a further fit is worth
constexpr int kMaxGroupThreads = 256;           // of a group

struct Gain {
  double weight, gain;
};

KV_HD Gain gain_of(double error, double reach) {
  double const x = error * (kEnd / (reach * reach));
  if (!(x < kEnd)) return {0, 0};
  double const weight = __builtin_exp(-x) - kRest;
  return {weight, weight + kRest * (x - kEnd)};
}

// The squared error of correspondence i of a problem under P = K [R | t]; infinite behind the camera, NaN if it does
// not exist.
template <class T>
KV_HD double squared_error(RobustPoses<T> const& p, int64_t b, double const* P, int64_t i) {
  int64_t const at = b * p.fit.count + i;
  if (p.mask && !p.mask[at]) return small::nan();
  double X[3], h[3];
  for (int k = 0; k < 3; ++k) X[k] = p.fit.points[3 * at + k];
  for (int k = 0; k < 3; ++k) h[k] = dot3(P + 4 * k, X) + P[4 * k + 3];
  double const u = h[0] / h[2] - p.fit.pixels[2 * at], v = h[1] / h[2] - p.fit.pixels[2 * at + 1],
               error = u * u + v * v;
  return h[2] > 0 && small::finite(error) ? error : __builtin_inf();
}

// K [R | t].
template <class T>
KV_HD void projection(RobustPoses<T> const& p, int64_t b, double const* pose, double* P) {
  double K[9];
  for (int i = 0; i < 9; ++i) K[i] = p.fit.camera[(p.fit.one_camera ? 0 : 9 * b) + i];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 4; ++k)
      P[4 * i + k] = K[3 * i] * pose[k] + K[3 * i + 1] * pose[4 + k] + K[3 * i + 2] * pose[8 + k];
}

template <class T>
KV_CALLED double score_hypothesis(RobustPoses<T> const& p, int64_t b, int64_t hypothesis) {
  double pose[12], P[12], score = 0;
  for (int i = 0; i < 12; ++i) pose[i] = p.hypotheses[12 * (b * p.num_hypotheses + hypothesis) + i];
  projection(p, b, pose, P);
  for (int64_t i = 0; i < p.fit.count; ++i) score += gain_of(squared_error(p, b, P, i), p.threshold).gain;
  return score;
}

struct Candidates {
  double scores[kMaxGroupThreads];
  int64_t hypotheses[kMaxGroupThreads];
};

// The hypothesis of the highest score, the first of equal ones.
template <class T, class Group>
KV_HD int64_t best_hypothesis(RobustPoses<T> const& p, int64_t b, Group group) {
  typename Group::template SharedStorage<Candidates> storage;
  Candidates& best = storage.get();
  double score = -1;
  int64_t own = 0;
  for (int64_t i = group.thread_rank(); i < p.num_hypotheses; i += group.num_threads()) {
    double const other = score_hypothesis(p, b, i);
    if (other > score) score = other, own = i;
  }
  best.scores[group.thread_rank()] = score;
  best.hypotheses[group.thread_rank()] = own;
  group.sync();
  for (int i = 0; i < group.num_threads(); ++i)
    if (best.scores[i] > score || (best.scores[i] == score && best.hypotheses[i] < own))
      score = best.scores[i], own = best.hypotheses[i];
  return own;
}

// Sets the weights and the inliers of a pose, and returns its score.
template <class T, class Group>
KV_HD double weigh(RobustPoses<T> const& p, int64_t b, double const* pose, Group group) {
  double R[9], matrix[12], P[12], score[1] = {};
  QuaternionToRotationMatrix::evaluate(pose, R, FormulaOptions{});
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) matrix[4 * i + k] = R[3 * i + k];
    matrix[4 * i + 3] = pose[4 + i];
  }
  projection(p, b, matrix, P);
  for (int64_t i = group.thread_rank(); i < p.fit.count; i += group.num_threads()) {
    double const error = squared_error(p, b, P, i);
    Gain const gain = gain_of(error, p.reach);
    p.fit.weights.set(b * p.fit.count + i, gain.weight);
    p.inliers[b * p.fit.count + i] = error <= p.threshold * p.threshold;
    score[0] += gain.gain;
  }
  return *group.sums(score);
}

// Whether the inliers are points on one line, about which the camera may turn. Threads ask for those that they set.
template <class T, class Group>
KV_HD bool are_on_line(RobustPoses<T> const& p, int64_t b, Group group) {
  double moments[Moments<3>::kCount] = {};
  for (int64_t i = group.thread_rank(); i < p.fit.count; i += group.num_threads()) {
    int64_t const at = b * p.fit.count + i;
    if (!p.inliers[at]) continue;
    double X[3];
    for (int k = 0; k < 3; ++k) X[k] = p.fit.points[3 * at + k];
    Moments<3>::add(X, moments);
  }
  return Moments<3>::are_on_line(group.sums(moments), p.fit.points.is_double);
}

}  // namespace robust_pose

template <class T, class Group>
KV_HD void fit_robust_pose(RobustPoses<T> const& p, int64_t b, Group group) {
  using namespace robust_pose;
  double R[9], pose[7], best[7], best_score = 0;
  int64_t const first = 12 * (b * p.num_hypotheses + best_hypothesis(p, b, group));
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) R[3 * i + k] = p.hypotheses[first + 4 * i + k];
    pose[4 + i] = p.hypotheses[first + 4 * i + 3];
  }
  RotationMatrixToQuaternion::evaluate(R, pose, FormulaOptions{});
  for (int i = 0; i < 7; ++i) best[i] = pose[i];
  for (int round = 0; round <= p.rounds; ++round) {
    double const score = weigh(p, b, pose, group);
    bool const rises = score > (round == 0 ? 0 : best_score * (1 + kTolerance));
    if (round == 0 || score > best_score) {
      best_score = score;
      for (int i = 0; i < 7; ++i) best[i] = pose[i];
    }
    if (!rises || round == p.rounds || !refine_pose(p.fit, b, pose, group).is_valid) break;
  }
  weigh(p, b, best, group);
  if (are_on_line(p, b, group))
    for (int64_t i = group.thread_rank(); i < p.fit.count; i += group.num_threads())
      p.inliers[b * p.fit.count + i] = false;
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 7; ++i) p.fit.poses.set(7 * b + i, best[i]);
}

}  // namespace kv::geometry
