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
// What is not a number fits nothing. Included by consensus_cpu.cpp, consensus.cu and consensus_op.cpp.
#pragma once

#include "minimal.h"

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

KV_KERNEL(consensus, Consensus)
KV_KERNEL(contest, Contest)

template <class V, class F>
KV_HD V transfer_error(F const* m, V x, V y, V u, V v) {
  V const w = x * m[6] + (y * m[7] + m[8]);
  V const p = x * m[0] + (y * m[1] + m[2]) - w * u, q = x * m[3] + (y * m[4] + m[5]) - w * v;
  return (p * p + q * q) / (w * w);
}

template <class V, class F>
KV_HD V sampson_error(F const* m, V x, V y, V u, V v) {
  V const a = x * m[0] + (y * m[1] + m[2]), b = x * m[3] + (y * m[4] + m[5]);
  V const c = u * m[0] + (v * m[3] + m[6]), d = u * m[1] + (v * m[4] + m[7]);
  V const r = a * u + (b * v + (x * m[6] + (y * m[7] + m[8])));
  return r * r / (a * a + b * b + c * c + d * d);
}

// Of the line through (u, v) and (s, t), from an end at (x, y): the distance times the segment's length.
template <class V, class F>
KV_HD V line_error(F const* m, V x, V y, V u, V v, V s, V t) {
  V const w = x * m[6] + (y * m[7] + m[8]);
  V const p = (x * m[0] + (y * m[1] + m[2])) / w - u, q = (x * m[3] + (y * m[4] + m[5])) / w - v;
  V const distance = p * (t - v) - q * (s - u);
  return distance < 0 ? -distance : distance;
}

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
