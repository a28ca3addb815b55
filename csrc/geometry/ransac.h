// Scores of models for RANSAC: the sum of 1 - e / t over correspondences whose squared error e is at most t (MSAC; P.
// Torr and A. Zisserman, 2000), and the number of these inliers. The error is
//
//   affine, homography   the distance of the mapped point from its correspondence
//   lines                the mean distance of both mapped ends from the line
//   other models         Sampson's distance: of both points from the nearest exact correspondence, to first order
//
// Correspondences are in random order. After every kChunk of them a model is given up whose sum is further below what a
// model of sum `least` has by then than chance explains, by kDeviations. Its scores are those so far.
//
// top_k_models selects the best models of lists, one for each pair of images.
//
// An error that is NaN is no inlier. Included by ransac_cpu.cpp, ransac.cu and ransac_op.cpp.
#pragma once

#include "geometry/residuals.h"
#include "geometry/solvers/minimal.h"

namespace kv::geometry {

constexpr int kChunk = 64;
constexpr double kDeviations = 2;

template <class T>
struct Consensus {
  T const *points1, *points2;   // (B, 2 or 4, N), one row for each coordinate
  T const* models;              // (B, M, 9)
  T const *least, *thresholds;  // (B); t is the square of a threshold
  Model model;
  int64_t batch, num_models, count;  // B, M, N
  T* scores;                         // (B, M, 2)

  KV_HD T squared_threshold(int64_t b) const { return thresholds[b] * thresholds[b]; }
  // The sum below which a model is given up after `seen` correspondences.
  KV_HD T bound(int64_t b, int64_t seen) const {
    T const mean = least[b] * (T(seen) / T(count));
    return mean - T(kDeviations) * sqrt(mean);
  }
};

template <class T>
struct TopKModels {
  T const *models, *scores;  // (B, M, 9), (B, M, 2)
  int64_t batch, num_models, top_k;
  bool by_count;
  T *top_models, *top_scores;  // (B, K, 9), (B, K, 2)

  KV_HD T score(int64_t b, int64_t i) const {
    T const value = scores[2 * (b * num_models + i) + by_count];
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
    for (; i < num_models; i += step)
      if ((last < 0 || is_better(b, last, i)) && i != last && is_better(b, i, index)) index = i;
    return index;
  }
  KV_HD void copy(int64_t b, int64_t src, int64_t rank) const {
    for (int k = 0; k < 9; ++k) top_models[9 * (b * top_k + rank) + k] = models[9 * (b * num_models + src) + k];
    for (int k = 0; k < 2; ++k) top_scores[2 * (b * top_k + rank) + k] = scores[2 * (b * num_models + src) + k];
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
