// Points transformed by matrices on the CPU: points [begin, end) of all matrices, chunks of them for the gradients.
// Compiled once per instruction set.
#include "core/lanes.h"
// Included after core/lanes.h, whose vsqrt it uses.
#include "geometry/transform_points.h"

namespace kv::geometry::KV_ISA {
namespace {

// Reads K coordinates of each of N points into the vectors from `column` on.
template <int N, int K, class T, class V, int W>
KV_HD void load_points(T const* from, V (&p)[W], int column = 0) {
  for (int k = 0; k < K; ++k) {
    if constexpr (N == 1)
      p[column + k] = load<1>(from + k);
    else
      for (int i = 0; i < N; ++i) p[column + k][i] = load<1>(from + i * K + k);
  }
}
template <int N, int K, class T, class V, int W>
KV_HD void store_points(T* to, V const (&p)[W], int column = 0) {
  for (int k = 0; k < K; ++k) {
    if constexpr (N == 1)
      store<1>(to + k, p[column + k]);
    else
      for (int i = 0; i < N; ++i) store<1>(to + i * K + k, Compute<T>(p[column + k][i]));
  }
}
template <class Map, int N, class T, class V>
KV_HD void load_arguments(T const* points, T const* depth, int64_t first, V (&p)[Map::in]) {
  if constexpr (__is_same(Map, Unproject)) {
    load_points<N, 2>(points + first * 2, p);
    load_points<N, 1>(depth + first, p, 2);
  } else {
    load_points<N, Map::in>(points + first * Map::in, p);
  }
}

// Calls f(lanes, i) for vectors of [begin, end), then for single points, each point once.
template <class T, class Call>
KV_HD void for_each_once(int64_t begin, int64_t end, Call f) {
  constexpr int N = kLanes<T>;
  int64_t i = begin;
  for (; i + N <= end; i += N) f(Width<N>{}, i);
  for (; i < end; ++i) f(Width<1>{}, i);
}

}  // namespace

template <class T>
void transform_points(TransformPoints<T> const& p, int64_t begin, int64_t end) {
  with_map(p.map, [&](auto map) {
    using Map = decltype(map);
    for (int64_t i = begin; i < end;) {
      int64_t const matrix = i / p.count, last = min(end, (matrix + 1) * p.count);
      Compute<T> const* const m = p.matrices + matrix * p.matrix_stride;
      for_each_once<T>(i, last, [&](auto lanes, int64_t first) {
        constexpr int N = decltype(lanes)::value;
        Lanes<Compute<T>, N> points[Map::in], y[Map::out];
        load_arguments<Map, N>(p.points, p.depth, first, points);
        Map::value(m, p.distance, points, y);
        store_points<N, Map::out>(p.y + first * Map::out, y);
      });
      i = last;
    }
  });
}

template <class T>
void transform_points_backward(TransformPointsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  with_map(p.map, [&](auto map) {
    using Map = decltype(map);
    int64_t const parts = p.parts();
    for (int64_t part = begin; part < end; ++part) {
      int64_t const matrix = part / parts, from = matrix * p.count + (part - matrix * parts) * p.part;
      int64_t const to = min(from + p.part, (matrix + 1) * p.count);
      F const* const m = p.matrices + matrix * p.matrix_stride;
      Lanes<F, kLanes<T>> sums[Map::entries] = {};
      for_each_once<T>(from, to, [&](auto lanes, int64_t first) {
        constexpr int N = decltype(lanes)::value;
        Lanes<F, N> points[Map::in], grad[Map::out], grad_points[Map::in], grad_m[Map::entries];
        load_arguments<Map, N>(p.points, p.depth, first, points);
        load_points<N, Map::out>(p.grad + first * Map::out, grad);
        Map::vjp(m, p.distance, points, grad, grad_points, grad_m);
        if constexpr (__is_same(Map, Unproject)) {
          store_points<N, 2>(p.grad_points + first * 2, grad_points);
          store_points<N, 1>(p.grad_depth + first, grad_points, 2);
        } else {
          store_points<N, Map::in>(p.grad_points + first * Map::in, grad_points);
        }
        if (!p.partial) return;
        for (int e = 0; e < Map::entries; ++e) {
          if constexpr (N == 1)
            sums[e][0] += grad_m[e];
          else
            sums[e] += grad_m[e];
        }
      });
      if (!p.partial) continue;
      for (int e = 0; e < Map::entries; ++e) {
        F sum = 0;
        for (int i = 0; i < kLanes<T>; ++i) sum += sums[e][i];
        p.partial[part * Map::entries + e] = sum;
      }
    }
  });
}

KV_INSTANTIATE(transform_points, TransformPoints)
KV_INSTANTIATE(transform_points_backward, TransformPointsBackward)

}  // namespace kv::geometry::KV_ISA
