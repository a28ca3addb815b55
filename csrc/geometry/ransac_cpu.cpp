// RANSAC's scores on the CPU: models [begin, end), correspondences in vectors. Compiled once per instruction set.
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "geometry/ransac.h"

namespace kv::geometry::KV_ISA {

namespace {

// The contribution of the correspondences from i on to both scores.
template <int N, class T>
KV_HD void add_scores(Consensus<T> const& p, T const* m, int64_t i, Lanes<T, N>& score, Lanes<T, N>& count) {
  using V = Lanes<T, N>;
  V const none{},
      e = squared_error<V>(p, m, i, [&](T const* x, int k, int64_t i) { return load<N>(x + k * p.count + i); });
  score += e <= p.squared_threshold ? V(1 - e * (1 / p.squared_threshold)) : none;
  count += e <= p.squared_threshold ? V(none + 1) : none;
}

}  // namespace

template <class T>
void consensus(Consensus<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  for (int64_t candidate = begin; candidate < end; ++candidate) {
    T const* const m = p.models + candidate * 9;
    Lanes<T, N> scores{}, counts{};
    T score = 0, count = 0;
    int64_t i = 0;
    for (; i + N <= p.count; i += N) add_scores<N>(p, m, i, scores, counts);
    for (; i < p.count; ++i) add_scores<1>(p, m, i, score, count);
    for (int k = 0; k < N; ++k) score += scores[k], count += counts[k];
    p.scores[2 * candidate] = score;
    p.scores[2 * candidate + 1] = count;
  }
}

template <class T>
void merge_top_k(MergeTopK<T> const& p, int64_t begin, int64_t end) {
  for (int64_t winner = 0; winner < p.num_candidates; ++winner) {
    int64_t const rank = p.rank_of(winner);
    if (rank < begin || rank >= end) continue;
    p.copy(winner, rank);
    T const* const m = p.model_of(winner);
    for_each_vector<T>(0, p.count, [&](auto lanes, int64_t i) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<T, N>;
      auto const read = [&](T const* x, int k, int64_t i) { return load<N>(x + k * p.count + i); };
      V const none{}, e = squared_error<V, T>(p, m, i, read);
      store<N>(p.weights + rank * p.count + i, V(e <= p.squared_threshold ? V(1 / (1 + e * p.softness)) : none));
    });
  }
}

// One thread runs this function: [begin, end) is the whole range.
template <class T>
void top_k_models(TopKModels<T> const& p, int64_t, int64_t) {
  for (int64_t rank = 0, last = -1; rank < p.top_k; ++rank) {
    last = p.next_best(last, 0, 1);
    p.copy(last, rank);
  }
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(top_k_models, TopKModels)
KV_INSTANTIATE_COMPUTED(merge_top_k, MergeTopK)

}  // namespace kv::geometry::KV_ISA
