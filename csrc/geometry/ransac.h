// How many correspondences fit models, and how well: the sum over those whose squared error e is at most t of 1 - e / t
// (MSAC; P. Torr and A. Zisserman, 2000), and how many they are. The error is
//
//   affine, homography       how far the point goes from where it should
//   lines                    the mean distance of both ends from the line
//   the others               Sampson's distance, of both points to the nearest ones that fit, to first order
//
// A contest finds the best models of two lists, and what correspondences weigh when these are fitted to them: those
// that fit 1 / (1 + s e), others 0.
//
// Leaders are the best of many models, before any contest. A verdict is the model that won it, and who fits it: none
// where these are no more than a sample.
//
// What is not a number fits nothing. Included by ransac_cpu.cpp, ransac.cu and ransac_op.cpp.
#pragma once

#include "geometry/residuals.h"
#include "geometry/solvers/minimal.h"

namespace kv {

template <class T>
struct Consensus {
  T const *points1, *points2;  // (2 or 4, N): coordinate by coordinate
  T const* models;             // (M, 9)
  Model model;
  T limit;  // t
  int64_t candidates, count;
  T* scores;  // (M, 2)
};

template <class T>
struct Contest : Consensus<T> {  // models and scores are those of the first list, of which there are `candidates`
  T const *others, *other_scores;
  int64_t total, kept;              // candidates of both, and how many are the best: K
  bool by_count;                    // the number of those who fit ranks models, not the sum
  T softness;                       // s
  T *best, *best_scores, *weights;  // (K, 9), (K, 2), (K, N)

  KV_HD T const* model_of(int64_t i) const {
    return i < this->candidates ? this->models + 9 * i : others + 9 * (i - this->candidates);
  }
  KV_HD T const* score_of(int64_t i) const {
    return i < this->candidates ? this->scores + 2 * i : other_scores + 2 * (i - this->candidates);
  }
  // How many are better, or as good and before it.
  KV_HD int64_t rank_of(int64_t i) const {
    T const score = score_of(i)[by_count];
    int64_t rank = 0;
    for (int64_t k = 0; k < total; ++k) {
      T const other = score_of(k)[by_count];
      rank += other > score || (other == score && k < i);
    }
    return rank;
  }
  KV_HD void copy(int64_t from, int64_t to) const {
    for (int k = 0; k < 9; ++k) best[9 * to + k] = model_of(from)[k];
    for (int k = 0; k < 2; ++k) best_scores[2 * to + k] = score_of(from)[k];
  }
};

template <class T>
struct Leaders {
  T const *models, *scores;  // (M, 9), (M, 2)
  int64_t candidates, kept;
  bool by_count;
  T *best, *best_scores;  // (K, 9), (K, 2)

  KV_HD T score(int64_t i) const {
    T const found = scores[2 * i + by_count];
    return found == found ? found : T(-__builtin_inf());
  }
  // Whether a model comes before another one: it is better, or as good and before it. One that is not there, -1, is
  // last.
  KV_HD bool before(int64_t i, int64_t k) const {
    if (i < 0 || k < 0) return i >= 0;
    T const one = score(i), other = score(k);
    return one > other || (!(one < other) && i < k);
  }
  // The first after `last`, -1 for the first of all, of those from `i` on in steps; -1 where there is none.
  KV_HD int64_t next(int64_t last, int64_t i, int64_t step) const {
    int64_t found = -1;
    for (; i < candidates; i += step)
      if ((last < 0 || before(last, i)) && i != last && before(i, found)) found = i;
    return found;
  }
  KV_HD void copy(int64_t from, int64_t to) const {
    for (int k = 0; k < 9; ++k) best[9 * to + k] = models[9 * from + k];
    for (int k = 0; k < 2; ++k) best_scores[2 * to + k] = scores[2 * from + k];
  }
};

template <class T>
struct Verdict {
  T const *model, *weights;  // (9), (N)
  int64_t count, least;      // correspondences, and more than how many have to fit
  bool unit_norm;            // the model becomes of norm 1; else its last number 1, unless that is 0
  T* found;                  // (9)
  bool* fits;                // (N)

  KV_HD void decide(bool some) const {
    T largest = 0, square = 0;
    for (int k = 0; k < 9; ++k) {
      T const size = model[k] < 0 ? -model[k] : model[k];
      if (size > largest) largest = size;
      square += model[k] * model[k];
    }
    T const last = model[8] < 0 ? -model[8] : model[8];
    T const by = unit_norm ? sqrt(square) : last > T(1e-12) * largest ? model[8] : largest > 0 ? largest : 1;
    for (int k = 0; k < 9; ++k) found[k] = some ? model[k] / by : 0;
  }
};

KV_KERNEL(consensus, Consensus)
KV_KERNEL(leaders, Leaders)
KV_KERNEL(verdict, Verdict)
KV_KERNEL(contest, Contest)

// read(points, k, i) gives coordinate k of the correspondences from i on.
template <class V, class T, class Read>
KV_HD V error_of(Consensus<T> const& p, T const* m, int64_t i, Read read) {
  V const x = read(p.points1, 0, i), y = read(p.points1, 1, i), u = read(p.points2, 0, i), v = read(p.points2, 1, i);
  if (p.model == Model::lines) {
    V const s = read(p.points2, 2, i), t = read(p.points2, 3, i);
    V const sum =
        line_error(m, x, y, u, v, s, t) + line_error(m, V(read(p.points1, 2, i)), V(read(p.points1, 3, i)), u, v, s, t);
    return sum * sum / (((s - u) * (s - u) + (t - v) * (t - v)) * 4);
  }
  return p.model <= Model::homography ? transfer_error(m, x, y, u, v) : sampson_error(m, x, y, u, v);
}

}  // namespace kv
