// Binary focal loss on the CPU: chunks [begin, end) of all rows. Compiled once per instruction set.
#include "binary_focal.h"
#include "metrics/pointwise_cpu.h"

namespace kv::losses::KV_ISA {

using namespace metrics::KV_ISA;

template <class T>
void binary_focal_sum(BinaryFocalSum<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  sum_row_chunks(p.pair, p.chunks, begin, end, p.partial, [&](int64_t row) {
    return [terms = p.terms.of(row)](auto width, auto x, auto t) {
      return BinaryFocalPoint<F, PointMath<F, decltype(width)::value>, decltype(x)>(terms, x).loss(t);
    };
  });
}

template <class T>
void binary_focal_map(BinaryFocalMap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  map_row_chunks(p.pair, begin, end, p.out, [&](int64_t row) {
    F const of_row = p.grad_of_sum ? p.grad_of_sum[row] : F(1);
    return [&p, of_row, terms = p.terms.of(row)](auto width, int64_t e, auto x, auto t) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      BinaryFocalPoint<F, PointMath<F, M>, V> const at(terms, x);
      if (!p.grad && !p.grad_of_sum) return at.loss(t);
      V const derivative = p.by_target ? at.target_derivative(t) : at.derivative(t);
      return p.grad ? V(derivative * load<M>(p.grad + e)) : V(derivative * of_row);
    };
  });
}

KV_INSTANTIATE(binary_focal_sum, BinaryFocalSum)
KV_INSTANTIATE(binary_focal_map, BinaryFocalMap)

}  // namespace kv::losses::KV_ISA
