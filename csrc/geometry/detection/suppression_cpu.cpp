// Suppression of boxes on the CPU: samples [begin, end). Compiled once per instruction set.
#include <cmath>

#include "core/any_lane.h"
#include "core/lanes.h"
#include "suppression.h"

namespace kv::geometry::KV_ISA {
namespace {

// Calls f(k) for boxes k from `first` on that may overlap `own`: with lanes, those whose edges cross.
template <class F, class Function>
KV_HD void for_each_near(F const* edges, int64_t n, BoxEdges<F> const& own, int64_t first, Function f) {
  constexpr int N = kLanes<F>;
  int64_t k = first;
  for (; k + N <= n; k += N) {
    auto const low_x = max(load<N>(edges + k), broadcast<N>(own.x0));
    auto const low_y = max(load<N>(edges + n + k), broadcast<N>(own.y0));
    auto const high_x = min(load<N>(edges + 2 * n + k), broadcast<N>(own.x1));
    auto const high_y = min(load<N>(edges + 3 * n + k), broadcast<N>(own.y1));
    if (any_lane((low_x < high_x) & (low_y < high_y)))
      for (int i = 0; i < N; ++i) f(k + i);
  }
  for (; k < n; ++k) f(k);
}

}  // namespace

template <class F>
void suppress_boxes(BoxSuppression<F> const& p, int64_t begin, int64_t end) {
  for (int64_t sample = begin; sample < end; ++sample) {
    F const* const edges = p.edges + sample * 4 * p.n;
    uint8_t* const kept = p.kept + sample * p.n;
    for (int64_t i = 0; i < p.n; ++i) kept[i] = 1;
    for (int64_t i = 0; i < p.n; ++i) {
      if (!kept[i]) continue;
      BoxEdges<F> const own = box_at(edges, p.n, i);
      auto const visit = [&](int64_t k) KV_INLINE {
        if (kept[k] && p.suppresses(sample, own, i, k)) kept[k] = 0;
      };
      if (p.threshold >= 0)
        for_each_near(edges, p.n, own, i + 1, visit);
      else  // boxes that do not touch have an overlap of 0, which exceeds it
        for (int64_t k = i + 1; k < p.n; ++k) visit(k);
    }
  }
}

template <class F>
void soft_suppress_boxes(SoftBoxSuppression<F> const& p, int64_t begin, int64_t end) {
  for (int64_t sample = begin; sample < end; ++sample) {
    F const* const edges = p.edges + sample * 4 * p.n;
    F* const left = p.left + sample * p.n;
    for (int64_t round = 0; round < p.n; ++round) {
      int64_t best = 0;
      for (int64_t k = 1; k < p.n; ++k)
        if (left[k] > left[best] || left[best] != left[best]) best = k;
      bool const chosen = left[best] >= p.min_score && left[best] != -F(__builtin_inf());
      p.order[sample * p.n + round] = chosen ? best : -1;
      p.scores[sample * p.n + round] = chosen ? left[best] : F(0);
      if (!chosen) continue;
      left[best] = -F(__builtin_inf());
      BoxEdges<F> const own = box_at(edges, p.n, best);
      for_each_near(edges, p.n, own, 0, [&](int64_t k) KV_INLINE { p.update(sample, own, best, k); });
    }
  }
}

KV_INSTANTIATE_COMPUTED(suppress_boxes, BoxSuppression)
KV_INSTANTIATE_COMPUTED(soft_suppress_boxes, SoftBoxSuppression)

}  // namespace kv::geometry::KV_ISA
