// Elementwise losses on the CPU: chunks [begin, end) of all rows for sums, blocks of a row for maps. Compiled once per
// instruction set.
#include "pointwise_cpu.h"

#include "pointwise.h"

namespace kv::metrics::KV_ISA {
template <class T>
void pointwise_sum(PointwiseSum<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  sum_row_chunks(p.pair, p.chunks, begin, end, p.partial, [&](int64_t) {
    return
        [&](auto width, auto x, auto y) { return point_loss<F, PointMath<F, decltype(width)::value>>(p.kind, x, y); };
  });
}

template <class T>
void pointwise_map(PointwiseMap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  map_row_chunks(p.pair, begin, end, p.out, [&](int64_t row) {
    F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
    return [&p, of_row](auto width, int64_t e, auto x, auto y) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      if (!p.grad && !p.grad_of_sum) return V(point_loss<F, PointMath<F, M>>(p.kind, x, y));
      V const derivative = point_derivative<F, PointMath<F, M>>(p.kind, p.by_other, x, y);
      return p.grad ? V(derivative * load<M>(p.grad + e)) : V(derivative * of_row);
    };
  });
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::metrics::KV_ISA
