// Lenses on the CPU: points [begin, end) of all problems, by vectors. Compiled once per instruction set.
#include "core/lanes.h"
// After it, for vectors.
#include "lens.h"

namespace kv::KV_ISA {
namespace {

template <bool There, int N, class T>
KV_HD void through(Lens<T> const& lens, int64_t i) {
  auto const& p = lens.p;
  Lanes<T, N> x, y;
  if constexpr (N == 1) {
    x = p.points[2 * i], y = p.points[2 * i + 1];
  } else {
    for (int k = 0; k < N; ++k) x[k] = p.points[2 * (i + k)], y[k] = p.points[2 * (i + k) + 1];
  }
  There ? lens.distort(x, y) : lens.undistort(x, y);
  if constexpr (N == 1) {
    p.result[2 * i] = x, p.result[2 * i + 1] = y;
  } else {
    for (int k = 0; k < N; ++k) p.result[2 * (i + k)] = x[k], p.result[2 * (i + k) + 1] = y[k];
  }
}

template <bool There, class T>
KV_HD void through_lenses(LensPoints<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  for (int64_t i = begin; i < end;) {
    int64_t const b = i / p.count, last = min(end, (b + 1) * p.count);  // of this lens
    Lens<T> const lens(p, b);
    for (; i + N <= last; i += N) through<There, N>(lens, i);
    for (; i < last; ++i) through<There, 1>(lens, i);
  }
}

}  // namespace

template <class T>
void undistort(LensPoints<T> const& p, int64_t begin, int64_t end) {
  through_lenses<false>(p, begin, end);
}

template <class T>
void distort(LensPoints<T> const& p, int64_t begin, int64_t end) {
  through_lenses<true>(p, begin, end);
}

KV_INSTANTIATE_COMPUTED(undistort, LensPoints)
KV_INSTANTIATE_COMPUTED(distort, LensPoints)

}  // namespace kv::KV_ISA
