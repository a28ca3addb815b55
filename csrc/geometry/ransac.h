// Scores of models for RANSAC: the sum of 1 - e / t over correspondences whose squared error e is at most t (MSAC; P.
// Torr and A. Zisserman, 2000), and the number of these inliers. The error is
//
//   affine, homography   the distance of the mapped point from its correspondence
//   lines                the mean distance of both mapped ends from the line
//   other models         Sampson's distance: of both points from the nearest exact correspondence, to first order
//
// Correspondences are in random order. Where as many models are kept as asked for, a model is given up that would not
// be kept, or has less than half the best sum: after every kChunk correspondences its sum is further below what a model
// of that sum has by then than chance explains, by kDeviations. Its scores are those so far.
//
// top_k_models selects the best of the models and of those kept so far, in lists, one for each pair of images.
//
// An error that is NaN is no inlier. Included by ransac_cpu.cpp, ransac.cu and ransac_op.cpp.
#pragma once

#include "geometry/residuals.h"
#include "geometry/solvers/minimal.h"

namespace kv::geometry {

constexpr int kChunk = 64;
constexpr double kDeviations = 2;

// The models kept so far, the best first.
template <class T>
struct KeptModels {
  T const *models, *scores;  // (B, L, 9), (B, L, 2)
  int64_t count;             // L
};

template <class T>
struct Consensus {
  T const *points1, *points2;  // (B, 2 or 4, N), one row for each coordinate
  T const* models;             // (B, M, 9)
  T const* thresholds;         // (B); t is the square of a threshold
  KeptModels<T> kept;
  bool gives_up;
  Model model;
  int64_t batch, num_models, count;  // B, M, N
  T* scores;                         // (B, M, 2)

  KV_HD T squared_threshold(int64_t b) const { return thresholds[b] * thresholds[b]; }
  // The sum that models need.
  KV_HD T least(int64_t b) const {
    if (!gives_up) return 0;
    T const *const first = kept.scores + 2 * b * kept.count, last = first[2 * (kept.count - 1)], half = *first / 2;
    return last > half ? last : half;
  }
  // The sum below which a model is given up after `seen` correspondences.
  KV_HD T bound(T least, int64_t seen) const {
    T const mean = least * (T(seen) / T(count));
    return mean - T(kDeviations) * sqrt(mean);
  }
};

template <class T>
struct TopKModels {
  T const *models, *scores;  // (B, M, 9), (B, M, 2)
  KeptModels<T> kept;        // which rank behind equal ones
  int64_t batch, num_models, top_k;
  bool by_count;
  T *top_models, *top_scores;  // (B, K, 9), (B, K, 2)

  KV_HD int64_t size() const { return num_models + kept.count; }
  KV_HD T const* model_at(int64_t b, int64_t i) const {
    return i < num_models ? models + 9 * (b * num_models + i) : kept.models + 9 * (b * kept.count + i - num_models);
  }
  KV_HD T const* scores_at(int64_t b, int64_t i) const {
    return i < num_models ? scores + 2 * (b * num_models + i) : kept.scores + 2 * (b * kept.count + i - num_models);
  }
  KV_HD T score(int64_t b, int64_t i) const {
    T const value = scores_at(b, i)[by_count];
    return value == value ? value : T(-__builtin_inf());
  }
  // Whether model i ranks before model k: its score is better, or equal and its index smaller. A missing one, -1, ranks
  // last.
  KV_HD bool is_better(int64_t b, int64_t i, int64_t k) const {
    if (i < 0 || k < 0) return i >= 0;
    T const first = score(b, i), second = score(b, k);
    return first > second || (!(first < second) && i < k);
  }
  // Of the models i, i + step, ..., the best one that ranks after `last` (-1: after none), or -1 if there is none.
  KV_HD int64_t next_best(int64_t b, int64_t last, int64_t i, int64_t step) const {
    int64_t index = -1;
    for (; i < size(); i += step)
      if ((last < 0 || is_better(b, last, i)) && i != last && is_better(b, i, index)) index = i;
    return index;
  }
  KV_HD void copy(int64_t b, int64_t src, int64_t rank) const {
    T const *const model = model_at(b, src), *const score = scores_at(b, src);
    for (int k = 0; k < 9; ++k) top_models[9 * (b * top_k + rank) + k] = model[k];
    for (int k = 0; k < 2; ++k) top_scores[2 * (b * top_k + rank) + k] = score[k];
  }
};

KV_KERNEL(consensus, Consensus)
KV_KERNEL(top_k_models, TopKModels)

// The squared errors of correspondences of pair b from i on; read(points) returns their coordinates, where `points` has
// the first of them.
template <class V, class T, class Read>
KV_HD V squared_error(Consensus<T> const& p, T const* m, int64_t b, int64_t i, Read read) {
  int64_t const start = b * (p.model == Model::lines ? 4 : 2) * p.count + i;
  T const *const one = p.points1 + start, *const two = p.points2 + start;
  V const x = read(one), y = read(one + p.count), u = read(two), v = read(two + p.count);
  if (p.model == Model::lines) {
    V const s = read(two + 2 * p.count), t = read(two + 3 * p.count);
    V const sum = line_error(m, x, y, u, v, s, t) +
                  line_error(m, V(read(one + 2 * p.count)), V(read(one + 3 * p.count)), u, v, s, t);
    return sum * sum / (((s - u) * (s - u) + (t - v) * (t - v)) * 4);
  }
  return p.model <= Model::homography ? transfer_error(m, x, y, u, v) : sampson_error(m, x, y, u, v);
}

}  // namespace kv::geometry
