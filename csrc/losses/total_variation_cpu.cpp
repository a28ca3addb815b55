// Total variation on the CPU: planes [begin, end), or for the gradient rows of all planes. Compiled once per
// instruction set.
#include "core/lanes.h"
#include "total_variation.h"

namespace kv::losses::KV_ISA {
namespace {

// The sum of abs(a[i] - b[i]) for i < n.
template <class T>
KV_HD Compute<T> sum_of_differences(T const* a, T const* b, int64_t n) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>, U = 4;
  Lanes<F, N> sums[U] = {};
  F total = 0;
  int64_t i = 0;
  for (; i + U * N <= n; i += U * N)
    for (int u = 0; u < U; ++u) sums[u] += vabs(Lanes<F, N>(load<N>(a + i + u * N) - load<N>(b + i + u * N)));
  for (; i < n; ++i) total += vabs(F(load<1>(a + i) - load<1>(b + i)));
  Lanes<F, N> const sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
  for (int l = 0; l < N; ++l) total += sum[l];
  return total;
}

}  // namespace

template <class T>
void total_variation(TotalVariation<T> const& p, int64_t begin, int64_t end) {
  for (int64_t plane = begin; plane < end; ++plane) {
    double along_y = 0, along_x = 0;
    for (int64_t y = 0; y < p.x.height; ++y) {
      T const* const row = p.x.row(plane, y);
      along_x += sum_of_differences(row + 1, row, p.x.width - 1);
      if (y + 1 < p.x.height) along_y += sum_of_differences(row + p.x.row_stride, row, p.x.width);
    }
    p.sums[plane] = Compute<T>(p.along_y * along_y + p.along_x * along_x);
  }
}

template <class T>
void total_variation_backward(TotalVariationBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.x.height, width = p.x.width;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    T const* const row = p.x.row(plane, y);
    T const* const above = y > 0 ? row - p.x.row_stride : row;
    T const* const below = y + 1 < height ? row + p.x.row_stride : row;
    F const of_y = p.along_y * p.grad[plane], of_x = p.along_x * p.grad[plane];
    T* const out = p.grad_x.row(plane, y);
    auto const at = [&](auto n, int64_t e, int64_t left, int64_t right) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      V const x = load<N>(row + e);
      auto const sign = [&](T const* other) { return sign_of(V(x - load<N>(other))); };
      store<N>(out + e, V((sign(above + e) + sign(below + e)) * of_y + (sign(row + left) + sign(row + right)) * of_x));
    };
    at(Width<1>{}, 0, 0, width > 1 ? 1 : 0);
    for_each_vector<T>(1, width - 1, [&](auto n, int64_t e) { at(n, e, e - 1, e + 1); });
    if (width > 1) at(Width<1>{}, width - 1, width - 2, width - 1);
  }
}

KV_INSTANTIATE(total_variation, TotalVariation)
KV_INSTANTIATE(total_variation_backward, TotalVariationBackward)

}  // namespace kv::losses::KV_ISA
