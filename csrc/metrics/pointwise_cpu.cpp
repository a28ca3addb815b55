// Losses element by element on the CPU: pieces [begin, end) of all rows for sums, blocks of a row's elements for maps.
// Compiled once per instruction set.
#include "core/lanes.h"
#include "pointwise.h"

namespace kv::KV_ISA {
namespace {

template <class F, int N>
struct Math {
  using V = Lanes<F, N>;
  KV_HD static V exp(V x) { return vexp2<F, N>(x * F(1.44269504088896340736)); }
  KV_HD static V sqrt(V x) { return vsqrt(x); }
  KV_HD static V divide(V x, V y) { return x / y; }
  // Of all numbers, those below the normal ones included.
  KV_HD static V log(V x) {
    constexpr F kSmall = sizeof(F) == 4 ? F(1e-37) : F(1e-300), kScale = F(1 << 30);
    V const zero{}, shift = x < kSmall ? broadcast<N>(F(30)) : zero;
    V const scaled = x < kSmall ? V(x * kScale) : x;
    V const found = (vlog2<F, N>(scaled) - shift) * F(0.69314718055994530942);
    V const beyond = x < zero ? broadcast<N>(F(__builtin_nan(""))) : broadcast<N>(-F(__builtin_inf()));
    return x <= zero ? beyond : found;
  }
};

}  // namespace

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
    for (; e + N <= count; e += N) sums += point_loss<F, Math<F, N>>(pair.kind, load<N>(x + e), load<N>(y + e));
    F sum = 0;
    for (; e < count; ++e) sum += point_loss<F, Math<F, 1>>(pair.kind, F(load<1>(x + e)), F(load<1>(y + e)));
    for (int l = 0; l < N; ++l) sum += sums[l];
    p.partial[i] = sum;
  }
}

template <class T>
void pointwise_map(PointwiseMap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Pair<T> const& pair = p.pair;
  int64_t const pieces = (pair.size + kPointPiece - 1) / kPointPiece;
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
        store<M>(out + e, V(point_slope<F, Math<F, M>>(pair.kind, p.by_other, x, y) * load<M>(grad + e)));
      else if (p.grad_of_sum)
        store<M>(out + e, V(point_slope<F, Math<F, M>>(pair.kind, p.by_other, x, y) * of_row));
      else
        store<M>(out + e, point_loss<F, Math<F, M>>(pair.kind, x, y));
    });
  }
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::KV_ISA
