// Losses element by element on the CPU: pieces [begin, end) of all rows for sums, blocks of a row's elements for maps.
// Compiled once per instruction set.
#include "pointwise.h"
#include "pointwise_math.h"

namespace kv::KV_ISA {
template <class T>
void pointwise_sum(PointwiseSum<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  Pair<T> const& pair = p.pair;
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / p.pieces, first = i % p.pieces * kPointPiece, count = min(kPointPiece, pair.size - first);
    T const *const x = pair.x + row * pair.x_stride + first, *const y = pair.y + row * pair.y_stride + first;
    Lanes<F, N> sums{};
    int64_t e = 0;
    for (; e + N <= count; e += N) sums += point_loss<F, PointMath<F, N>>(p.kind, load<N>(x + e), load<N>(y + e));
    F sum = 0;
    for (; e < count; ++e) sum += point_loss<F, PointMath<F, 1>>(p.kind, F(load<1>(x + e)), F(load<1>(y + e)));
    for (int l = 0; l < N; ++l) sum += sums[l];
    p.partial[i] = sum;
  }
}

template <class T>
void pointwise_map(PointwiseMap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Pair<T> const& pair = p.pair;
  int64_t const pieces = point_pieces(pair.size);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / pieces, first = i % pieces * kPointPiece;
    T const *const xs = pair.x + row * pair.x_stride, *const ys = pair.y + row * pair.y_stride;
    T const* const grad = p.grad ? p.grad + row * pair.size : nullptr;
    T* const out = p.out + row * pair.size;
    F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
    for_each_vector<T>(first, min(first + kPointPiece, pair.size), [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      V const x = load<M>(xs + e), y = load<M>(ys + e);
      if (grad)
        store<M>(out + e, V(point_slope<F, PointMath<F, M>>(p.kind, p.by_other, x, y) * load<M>(grad + e)));
      else if (p.grad_of_sum)
        store<M>(out + e, V(point_slope<F, PointMath<F, M>>(p.kind, p.by_other, x, y) * of_row));
      else
        store<M>(out + e, point_loss<F, PointMath<F, M>>(p.kind, x, y));
    });
  }
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::KV_ISA
