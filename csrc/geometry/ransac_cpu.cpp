// Consensus on the CPU: models [begin, end), correspondences by vectors. Compiled once per instruction set.
#include "core/lanes.h"
// After it, for vectors.
#include "geometry/ransac.h"

namespace kv::KV_ISA {

namespace {

// What the correspondences from i on add to both scores.
template <int N, class T>
KV_HD void add_scores(Consensus<T> const& p, T const* m, int64_t i, Lanes<T, N>& score, Lanes<T, N>& count) {
  using V = Lanes<T, N>;
  V const none{}, e = error_of<V>(p, m, i, [&](T const* x, int k, int64_t i) { return load<N>(x + k * p.count + i); });
  score += e <= p.limit ? V(1 - e * (1 / p.limit)) : none;
  count += e <= p.limit ? V(none + 1) : none;
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
void contest(Contest<T> const& p, int64_t begin, int64_t end) {
  for (int64_t winner = 0; winner < p.total; ++winner) {
    int64_t const rank = p.rank_of(winner);
    if (rank < begin || rank >= end) continue;
    p.copy(winner, rank);
    T const* const m = p.model_of(winner);
    for_each_vector<T>(0, p.count, [&](auto lanes, int64_t i) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<T, N>;
      auto const read = [&](T const* x, int k, int64_t i) { return load<N>(x + k * p.count + i); };
      V const none{}, e = error_of<V, T>(p, m, i, read);
      store<N>(p.weights + rank * p.count + i, V(e <= p.limit ? V(1 / (1 + e * p.softness)) : none));
    });
  }
}

// Nobody shares these two: [begin, end) is all there is.
template <class T>
void leaders(Leaders<T> const& p, int64_t, int64_t) {
  for (int64_t rank = 0, last = -1; rank < p.kept; ++rank) {
    last = p.next(last, 0, 1);
    p.copy(last, rank);
  }
}

template <class T>
void verdict(Verdict<T> const& p, int64_t, int64_t) {
  int64_t fitting = 0;
  for (int64_t i = 0; i < p.count; ++i) fitting += p.weights[i] > 0;
  bool const some = fitting > p.least;
  for (int64_t i = 0; i < p.count; ++i) p.fits[i] = some && p.weights[i] > 0;
  p.decide(some);
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(leaders, Leaders)
KV_INSTANTIATE_COMPUTED(verdict, Verdict)
KV_INSTANTIATE_COMPUTED(contest, Contest)

}  // namespace kv::KV_ISA
