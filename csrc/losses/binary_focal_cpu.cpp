// The binary focal loss on the CPU: pieces [begin, end) of all rows. Compiled once per instruction set.
#include "binary_focal.h"
#include "metrics/pointwise_math.h"

namespace kv::KV_ISA {

template <class T>
void binary_focal_sum(BinaryFocalSum<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  Pair<T> const& pair = p.pair;
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / p.pieces, first = i % p.pieces * kPointPiece, count = min(kPointPiece, pair.size - first);
    T const *const x = pair.x + row * pair.x_stride + first, *const t = pair.y + row * pair.y_stride + first;
    BinaryFocalTerms<F> const terms = p.terms.of(row);
    auto const loss = [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      return BinaryFocalPoint<F, PointMath<F, M>, V>(terms, V(load<M>(x + e))).loss(V(load<M>(t + e)));
    };
    Lanes<F, N> sums{};
    int64_t e = 0;
    for (; e + N <= count; e += N) sums += loss(Width<N>{}, e);
    F sum = 0;
    for (; e < count; ++e) sum += loss(Width<1>{}, e);
    for (int l = 0; l < N; ++l) sum += sums[l];
    p.partial[i] = sum;
  }
}

template <class T>
void binary_focal_map(BinaryFocalMap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Pair<T> const& pair = p.pair;
  int64_t const pieces = point_pieces(pair.size);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / pieces, first = i % pieces * kPointPiece;
    T const *const xs = pair.x + row * pair.x_stride, *const ts = pair.y + row * pair.y_stride;
    T const* const grad = p.grad ? p.grad + row * pair.size : nullptr;
    T* const out = p.out + row * pair.size;
    F const of_row = p.grad_of_sum ? p.grad_of_sum[row] : F(1);
    BinaryFocalTerms<F> const terms = p.terms.of(row);
    for_each_vector<T>(first, min(first + kPointPiece, pair.size), [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      V const t = load<M>(ts + e);
      BinaryFocalPoint<F, PointMath<F, M>, V> const at(terms, V(load<M>(xs + e)));
      if (!grad && !p.grad_of_sum) {
        store<M>(out + e, at.loss(t));
      } else {
        V const slope = p.by_target ? at.slope_by_target(t) : at.slope(t);
        store<M>(out + e, grad ? V(slope * load<M>(grad + e)) : V(slope * of_row));
      }
    });
  }
}

KV_INSTANTIATE(binary_focal_sum, BinaryFocalSum)
KV_INSTANTIATE(binary_focal_map, BinaryFocalMap)

}  // namespace kv::KV_ISA
