// Losses element by element on the CPU: pieces [begin, end) of all rows for sums, blocks of a row's elements for maps.
// Compiled once per instruction set.
#include "pointwise.h"
#include "pointwise_math.h"

namespace kv::KV_ISA {
template <class T>
void pointwise_sum(PointwiseSum<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  sum_pieces(p.pair, p.pieces, begin, end, p.partial, [&](int64_t) {
    return
        [&](auto width, auto x, auto y) { return point_loss<F, PointMath<F, decltype(width)::value>>(p.kind, x, y); };
  });
}

template <class T>
void pointwise_map(PointwiseMap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  map_pieces(p.pair, begin, end, p.out, [&](int64_t row) {
    F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
    return [&p, of_row](auto width, int64_t e, auto x, auto y) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      if (!p.grad && !p.grad_of_sum) return V(point_loss<F, PointMath<F, M>>(p.kind, x, y));
      V const slope = point_slope<F, PointMath<F, M>>(p.kind, p.by_other, x, y);
      return p.grad ? V(slope * load<M>(p.grad + e)) : V(slope * of_row);
    };
  });
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::KV_ISA
