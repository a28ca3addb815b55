// Scores of models for RANSAC: the sum of 1 - e / t over correspondences whose squared error e is at most t (MSAC; P.
// Torr and A. Zisserman, 2000), and the number of these inliers. The error is
//
//   affine, homography   the distance of the mapped point from its correspondence
//   lines                the mean distance of both mapped ends from the line
//   other models         Sampson's distance: of both points from the nearest exact correspondence, to first order
//
// merge_top_k selects the best models of two lists, and computes weights for fitting them to their inliers: 1 / (1 + s
// e) for inliers, else 0. top_k_models selects the best models of one long list.
//
// An error that is NaN is no inlier. Included by ransac_cpu.cpp, ransac.cu and ransac_op.cpp.
#pragma once

#include "geometry/residuals.h"
#include "geometry/solvers/minimal.h"

namespace kv::geometry {

template <class T>
struct Consensus {
  T const *points1, *points2;  // (2 or 4, N), one row for each coordinate
  T const* models;             // (M, 9)
  Model model;
  T squared_threshold;  // t
  int64_t num_models, count;
  T* scores;  // (M, 2)
};

template <class T>
struct MergeTopK : Consensus<T> {  // the first list is in models and scores: num_models of them
  T const *other_models, *other_scores;
  int64_t num_candidates, top_k;         // models of both lists, and K, the number of best models
  bool by_count;                         // whether the number of inliers ranks models, not the sum
  T softness;                            // s
  T *top_models, *top_scores, *weights;  // (K, 9), (K, 2), (K, N)

  KV_HD T const* model_of(int64_t i) const {
    return i < this->num_models ? this->models + 9 * i : other_models + 9 * (i - this->num_models);
  }
  KV_HD T const* score_of(int64_t i) const {
    return i < this->num_models ? this->scores + 2 * i : other_scores + 2 * (i - this->num_models);
  }
  // The number of models that rank before model i: with a better score, or an equal one and a smaller index.
  KV_HD int64_t rank_of(int64_t i) const {
    T const score = score_of(i)[by_count];
    int64_t rank = 0;
    for (int64_t k = 0; k < num_candidates; ++k) {
      T const competitor = score_of(k)[by_count];
      rank += competitor > score || (competitor == score && k < i);
    }
    return rank;
  }
  KV_HD void copy(int64_t src, int64_t rank) const {
    for (int k = 0; k < 9; ++k) top_models[9 * rank + k] = model_of(src)[k];
    for (int k = 0; k < 2; ++k) top_scores[2 * rank + k] = score_of(src)[k];
  }
};

template <class T>
struct TopKModels {
  T const *models, *scores;  // (M, 9), (M, 2)
  int64_t num_models, top_k;
  bool by_count;
  T *top_models, *top_scores;  // (K, 9), (K, 2)

  KV_HD T score(int64_t i) const {
    T const value = scores[2 * i + by_count];
    return value == value ? value : T(-__builtin_inf());
  }
  // Whether model i ranks before model k: its score is better, or equal and its index smaller. A missing one, -1, ranks
  // last.
  KV_HD bool is_better(int64_t i, int64_t k) const {
    if (i < 0 || k < 0) return i >= 0;
    T const first = score(i), second = score(k);
    return first > second || (!(first < second) && i < k);
  }
  // Of the models i, i + step, ..., the best one that ranks after `last` (-1: after none), or -1 if there is none.
  KV_HD int64_t next_best(int64_t last, int64_t i, int64_t step) const {
    int64_t index = -1;
    for (; i < num_models; i += step)
      if ((last < 0 || is_better(last, i)) && i != last && is_better(i, index)) index = i;
    return index;
  }
  KV_HD void copy(int64_t src, int64_t rank) const {
    for (int k = 0; k < 9; ++k) top_models[9 * rank + k] = models[9 * src + k];
    for (int k = 0; k < 2; ++k) top_scores[2 * rank + k] = scores[2 * src + k];
  }
};

KV_KERNEL(consensus, Consensus)
KV_KERNEL(top_k_models, TopKModels)
KV_KERNEL(merge_top_k, MergeTopK)

// read(points, k, i) returns coordinate k of the correspondences from i on.
template <class V, class T, class Read>
KV_HD V squared_error(Consensus<T> const& p, T const* m, int64_t i, Read read) {
  V const x = read(p.points1, 0, i), y = read(p.points1, 1, i), u = read(p.points2, 0, i), v = read(p.points2, 1, i);
  if (p.model == Model::lines) {
    V const s = read(p.points2, 2, i), t = read(p.points2, 3, i);
    V const sum =
        line_error(m, x, y, u, v, s, t) + line_error(m, V(read(p.points1, 2, i)), V(read(p.points1, 3, i)), u, v, s, t);
    return sum * sum / (((s - u) * (s - u) + (t - v) * (t - v)) * 4);
  }
  return p.model <= Model::homography ? transfer_error(m, x, y, u, v) : sampson_error(m, x, y, u, v);
}

}  // namespace kv::geometry
