// Greedy suppression of boxes: a kept box removes the boxes behind it that overlap it by more than a threshold. Boxes
// are planes of edges, so that a vector or a warp reads neighbors at once.
#pragma once

#include "core/ceil_div.h"
#include "core/isa.h"
#include "core/product.h"

namespace kv::geometry {

template <class F>
struct BoxEdges {
  F x0, y0, x1, y1;

  KV_HD F area() const { return product(x1 - x0, y1 - y0); }
  // The intersection over union. That of boxes without area is NaN, which exceeds no threshold.
  KV_HD F overlap(BoxEdges const& other) const {
    F const width = min(x1, other.x1) - max(x0, other.x0), height = min(y1, other.y1) - max(y0, other.y0);
    F const both = width > 0 && height > 0 ? product(width, height) : F(0);
    return both / (area() + other.area() - both);
  }
};

// Box i of planes (4, n).
template <class F>
KV_HD BoxEdges<F> box_at(F const* edges, int64_t n, int64_t i) {
  return {edges[i], edges[n + i], edges[2 * n + i], edges[3 * n + i]};
}

constexpr int kBoxesOfWord = 64;

template <class F>
struct BoxSuppression {
  F const* edges;         // (batch, 4, n), the best box first
  int64_t const* labels;  // (batch, n); only boxes of one label suppress each other. No data if all have one.
  int64_t batch, n;
  F threshold;
  uint8_t* kept;  // (batch, n) of 0 and 1

  // On CUDA: for `strip` boxes at once the words (batch, strip, words) of those behind them that they overlap, and the
  // words (batch, words) of removed boxes, 0 at first.
  uint64_t *overlaps, *removed;
  int64_t strip;

  KV_HD int64_t words() const { return ceil_div(n, int64_t(kBoxesOfWord)); }
  KV_HD bool suppresses(int64_t sample, BoxEdges<F> const& own, int64_t i, int64_t k) const {
    BoxEdges<F> const other = box_at(edges + sample * 4 * n, n, k);
    return own.overlap(other) > threshold && (!labels || labels[sample * n + i] == labels[sample * n + k]);
  }
};

enum class Decay : int { linear, gaussian };

// Boxes in the order of their decayed scores. After each choice the scores of overlapping boxes decay: linear by
// 1 - overlap beyond the threshold, gaussian by exp(-overlap^2 / sigma).
template <class F>
struct SoftBoxSuppression {
  F const* edges;         // (batch, 4, n)
  int64_t const* labels;  // as above
  int64_t batch, n;
  F threshold, sigma, min_score;
  Decay decay;
  F* left;         // (batch, n): the scores of boxes that are not chosen yet, changed; a chosen one has -infinity
  int64_t* order;  // (batch, n): the chosen boxes, then -1
  F* scores;       // (batch, n): their scores, then 0

  KV_HD F decayed(F score, F overlap) const {
    if (!(overlap > 0)) return score;  // NaN as well: a box without area
    if (decay == Decay::linear) return overlap > threshold ? score * (1 - overlap) : score;
    return score * F(::exp(double(-overlap * overlap / sigma)));
  }
  KV_HD void update(int64_t sample, BoxEdges<F> const& chosen, int64_t i, int64_t k) const {
    if (labels && labels[sample * n + i] != labels[sample * n + k]) return;
    F& score = left[sample * n + k];
    score = decayed(score, chosen.overlap(box_at(edges + sample * 4 * n, n, k)));
  }
};

KV_KERNEL(suppress_boxes, BoxSuppression)
KV_KERNEL(soft_suppress_boxes, SoftBoxSuppression)

}  // namespace kv::geometry
