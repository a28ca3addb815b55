// Undistortion on the CPU: points [begin, end) of all problems, by vectors. Compiled once per instruction set.
#include "core/lanes.h"
// After it, for vectors.
#include "undistort.h"

namespace kv::KV_ISA {
namespace {

template <int N, class T>
KV_HD void undistort_points(Undistort<T> const& p, int64_t i) {
  Lanes<T, N> x, y;
  if constexpr (N == 1) {
    x = p.points[2 * i], y = p.points[2 * i + 1];
  } else {
    for (int k = 0; k < N; ++k) x[k] = p.points[2 * (i + k)], y[k] = p.points[2 * (i + k) + 1];
  }
  undistort_of(p, i / p.count, x, y);
  if constexpr (N == 1) {
    p.result[2 * i] = x, p.result[2 * i + 1] = y;
  } else {
    for (int k = 0; k < N; ++k) p.result[2 * (i + k)] = x[k], p.result[2 * (i + k) + 1] = y[k];
  }
}

}  // namespace

template <class T>
void undistort(Undistort<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  for (int64_t i = begin; i < end;) {
    int64_t const last = min(end, (i / p.count + 1) * p.count);  // of this camera
    for (; i + N <= last; i += N) undistort_points<N>(p, i);
    for (; i < last; ++i) undistort_points<1>(p, i);
  }
}

KV_INSTANTIATE_COMPUTED(undistort, Undistort)

}  // namespace kv::KV_ISA
