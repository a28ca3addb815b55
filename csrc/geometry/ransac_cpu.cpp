// RANSAC's scores on the CPU: models [begin, end) of all pairs, correspondences in vectors. Compiled once per
// instruction set.
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "geometry/ransac.h"

namespace kv::geometry::KV_ISA {

namespace {

// The contribution of the correspondences from i on to both scores.
template <int N, class T>
KV_HD void add_scores(Consensus<T> const& p, T const* m, int64_t b, int64_t i, Lanes<T, N>& score, Lanes<T, N>& count) {
  using V = Lanes<T, N>;
  T const t = p.squared_threshold(b);
  V const none{}, e = squared_error<V>(p, m, b, i, [](T const* x) KV_INLINE { return load<N>(x); }).value();
  score += e <= t ? V(1 - e * (1 / t)) : none;
  count += e <= t ? V(none + 1) : none;
}

template <int N, class T>
KV_HD T sum(Lanes<T, N> x) {
  T sum = 0;
  for (int k = 0; k < N; ++k) sum += x[k];
  return sum;
}

}  // namespace

template <class T>
void consensus(Consensus<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  for (int64_t candidate = begin; candidate < end; ++candidate) {
    int64_t const b = candidate / p.num_models;
    T const *const m = p.models + candidate * 9, least = p.least(b);
    Lanes<T, N> scores{}, counts{};
    T score = 0, count = 0, is_known = 0;
    for (int k = 0; k < 9; ++k) is_known += m[k];
    bool is_given_up = !(is_known == is_known);
    int64_t i = 0;
    for (; i + kChunk <= p.count && !is_given_up;) {
      for (int64_t const rest = i + kChunk; i < rest; i += N) add_scores<N>(p, m, b, i, scores, counts);
      is_given_up = sum<N, T>(scores) < p.bound(least, i);
    }
    if (!is_given_up) {
      for (; i + N <= p.count; i += N) add_scores<N>(p, m, b, i, scores, counts);
      for (; i < p.count; ++i) add_scores<1>(p, m, b, i, score, count);
    }
    p.scores[2 * candidate] = score + sum<N, T>(scores);
    p.scores[2 * candidate + 1] = count + sum<N, T>(counts);
  }
}

// The best models so far are in order; each model moves up to its rank among them.
template <class T>
void top_k_models(TopKModels<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    T *const models = p.top_models + 9 * b * p.top_k, *const scores = p.top_scores + 2 * b * p.top_k;
    auto const rankable = [](T score) KV_INLINE { return score == score ? score : T(-__builtin_inf()); };
    for (int64_t i = 0, count = 0; i < p.size(); ++i) {
      T const score = p.score(b, i);
      if (count == p.top_k && !(score > rankable(scores[2 * (count - 1) + p.by_count]))) continue;
      int64_t rank = count < p.top_k ? count++ : count - 1;
      for (; rank > 0 && score > rankable(scores[2 * (rank - 1) + p.by_count]); --rank) {
        for (int k = 0; k < 9; ++k) models[9 * rank + k] = models[9 * (rank - 1) + k];
        for (int k = 0; k < 2; ++k) scores[2 * rank + k] = scores[2 * (rank - 1) + k];
      }
      p.copy(b, i, rank);
    }
  }
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(top_k_models, TopKModels)

#if !defined(__AVX512F__)  // in double
template <class T>
void select_inliers(Selection<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) select_pair(p, b, SingleThread{});
}

KV_INSTANTIATE_ONE(select_inliers, Selection, double)
#endif

}  // namespace kv::geometry::KV_ISA
