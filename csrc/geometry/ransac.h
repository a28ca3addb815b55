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
// top_k_models selects the best of the models and of those kept so far, in lists, one for each pair of images, and
// tells how many samples are required before the best of a pair has the requested confidence.
//
// select_inliers finds the inliers of the final model of each pair.
//
// An error that is NaN is no inlier.
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
  T const* counts;  // (B): correspondences that exist
  int sample_size;
  double log_failure;          // log(1 - confidence)
  int64_t budget;              // the most samples
  T *top_models, *top_scores;  // (B, K, 9), (B, K, 2)
  int64_t* required;           // (B)

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
    if (rank == 0) required[b] = required_samples(score[1], counts[b]);
  }
  // The number of samples among which one has only inliers with the requested confidence.
  KV_HD int64_t required_samples(double inliers, double count) const {
    if (count < sample_size) return 0;
    double good = 1;
    for (int i = 0; i < sample_size; ++i) good *= max(inliers - i, 0.) / (count - i);
    double const samples = __builtin_ceil(log_failure / __builtin_log1p(-good));
    return samples < double(budget) ? max(int64_t(samples), int64_t(1)) : budget;
  }
};

// Points (B, N, 2 or 4), weights (B, N) or null, thresholds (B), models (B, 9) -> models of unit last entry, essential
// ones of norm 1, and their inliers. Inliers of a sample alone say nothing for its model, but where there are no more
// correspondences, nor do points on one line for a map: then both are 0.
template <class T>
struct Selection {
  Reals points1, points2, weights, thresholds, models;
  Model model;
  int64_t batch, count;
  Reals scaled;
  bool* inliers;
};

KV_KERNEL(consensus, Consensus)
KV_KERNEL(select_inliers, Selection)
KV_KERNEL(top_k_models, TopKModels)

// The squared error of correspondences: points (x, y) of both images, or both ends of segments.
template <class V, class T>
KV_HD Fraction<V> squared_error(Model model, T const* m, V const* one, V const* two) {
  if (model == Model::lines) {
    V const u = two[0], v = two[1], s = two[2], t = two[3];
    V const sum = line_error(m, one[0], one[1], u, v, s, t) + line_error(m, one[2], one[3], u, v, s, t);
    return {sum * sum, ((s - u) * (s - u) + (t - v) * (t - v)) * 4};
  }
  return model <= Model::homography ? transfer_fraction(m, one[0], one[1], two[0], two[1])
                                    : sampson_fraction(m, one[0], one[1], two[0], two[1]);
}

// Those of pair b from i on; read(points) returns their coordinates, where `points` has the first of them.
template <class V, class T, class Read>
KV_HD Fraction<V> squared_error(Consensus<T> const& p, T const* m, int64_t b, int64_t i, Read read) {
  int64_t const start = b * (p.model == Model::lines ? 4 : 2) * p.count + i;
  T const *const x = p.points1 + start, *const y = p.points2 + start;
  V one[4] = {read(x), read(x + p.count)}, two[4] = {read(y), read(y + p.count)};
  if (p.model == Model::lines) {
    one[2] = read(x + 2 * p.count), one[3] = read(x + 3 * p.count);
    two[2] = read(y + 2 * p.count), two[3] = read(y + 3 * p.count);
  }
  return squared_error<V>(p.model, m, one, two);
}

// Threads of a group take correspondences in turns.
template <class T, class Group>
KV_HD void select_pair(Selection<T> const& p, int64_t b, Group group) {
  int const numbers = p.model == Model::lines ? 4 : 2, size = sample_size(p.model);
  double const threshold = p.thresholds[b];
  double m[9], largest = 0, square = 0;
  for (int k = 0; k < 9; ++k) {
    m[k] = p.models[9 * b + k];
    largest = max(largest, small::magnitude(m[k])), square += m[k] * m[k];
  }
  using Points = Moments<2>;
  double sums[Points::kCount + 1] = {};  // moments of the inliers' first points, or their number; and correspondences
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    int64_t const at = b * p.count + i;
    bool const exists = !p.weights.data || p.weights[at] > 0;
    double one[4], two[4];
    for (int k = 0; k < numbers; ++k) one[k] = p.points1[at * numbers + k], two[k] = p.points2[at * numbers + k];
    bool const is_inlier = exists && squared_error<double>(p.model, m, one, two).value() <= threshold * threshold;
    p.inliers[at] = is_inlier;
    sums[Points::kCount] += exists;
    if (!is_inlier) continue;
    p.model > Model::homography ? void(++sums[0]) : Points::add(one, sums);
  }
  double const* const all = group.sums(sums);
  bool const is_spread = p.model > Model::homography || !Points::are_on_line(all, p.points1.is_double);
  bool const has_model = is_spread && all[0] > max(min(all[Points::kCount] - 1, double(size)), 0.);
  if (!has_model)
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) p.inliers[b * p.count + i] = false;
  double const last = small::magnitude(m[8]) > 1e-12 * largest ? m[8] : largest;
  double const scale = 1 / (p.model == Model::essential ? sqrt(square) : last);
  for (int k = group.thread_rank(); k < 9; k += group.num_threads())
    p.scaled.set(9 * b + k, has_model ? m[k] * scale : 0);
}

}  // namespace kv::geometry
