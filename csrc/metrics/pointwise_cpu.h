// Elementwise losses on the CPU: math functions of vectors, and the traversal of two tensors. Included by *_cpu.cpp
// files.
#pragma once

#include "core/lanes.h"
#include "pointwise.h"

namespace kv::metrics::KV_ISA {
namespace {

template <class F, int N>
struct PointMath {
  using V = Lanes<F, N>;
  KV_HD static V exp(V x) { return vexp2<F, N>(x * F(1.44269504088896340736)); }
  KV_HD static V sqrt(V x) { return vsqrt(x); }
  KV_HD static V divide(V x, V y) { return x / y; }
  // Of all numbers, including subnormal ones.
  KV_HD static V log(V x) {
    constexpr F kSmall = sizeof(F) == 4 ? F(1e-37) : F(1e-300), kScale = F(1 << 30);
    V const zero{}, shift = x < kSmall ? broadcast<N>(F(30)) : zero;
    V const scaled = x < kSmall ? V(x * kScale) : x;
    V const result = (vlog2<F, N>(scaled) - shift) * F(0.69314718055994530942);
    V const at_most_zero = x < zero ? broadcast<N>(F(__builtin_nan(""))) : broadcast<N>(-F(__builtin_inf()));
    return x <= zero ? at_most_zero : result;
  }
};

// Sums chunks [begin, end) of all rows. of_row(row) returns a function of a Width and of vectors of x and y.
template <class T, class Row>
KV_HD void sum_row_chunks(Pair<T> const& pair, int64_t chunks, int64_t begin, int64_t end, Compute<T>* partial,
                          Row of_row) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / chunks, first = i % chunks * kPointChunk, count = min(kPointChunk, pair.size - first);
    T const *const x = pair.x + row * pair.x_stride + first, *const y = pair.y + row * pair.y_stride + first;
    auto const loss = of_row(row);
    Lanes<F, N> sums{};
    int64_t e = 0;
    for (; e + N <= count; e += N) sums += loss(Width<N>{}, load<N>(x + e), load<N>(y + e));
    F sum = 0;
    for (; e < count; ++e) sum += loss(Width<1>{}, F(load<1>(x + e)), F(load<1>(y + e)));
    for (int l = 0; l < N; ++l) sum += sums[l];
    partial[i] = sum;
  }
}

// Writes chunks [begin, end) of all rows. of_row(row) returns a function of a Width, the index of the first element,
// and vectors of x and y.
template <class T, class Row>
KV_HD void map_row_chunks(Pair<T> const& pair, int64_t begin, int64_t end, T* out, Row of_row) {
  int64_t const chunks = point_chunks(pair.size);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / chunks, first = i % chunks * kPointChunk, start = row * pair.size;
    T const *const x = pair.x + row * pair.x_stride, *const y = pair.y + row * pair.y_stride;
    auto const value = of_row(row);
    for_each_vector<T>(first, min(first + kPointChunk, pair.size), [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<Compute<T>, M>;
      store<M>(out + start + e, V(value(width, start + e, V(load<M>(x + e)), V(load<M>(y + e)))));
    });
  }
}

}  // namespace
}  // namespace kv::metrics::KV_ISA
