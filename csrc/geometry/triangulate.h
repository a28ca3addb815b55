// Points in space from their pictures in two images: the null vectors of x P3 - P1, y P3 - P2 of both, P's rows being
// P1, P2, P3. Included by triangulate_cpu.cpp, triangulate.cu and triangulate_op.cpp.
#pragma once

#include "core/isa.h"
#include "small_matrix.h"

namespace kv {

template <class T>
struct Triangulate {
  Reals points1, points2;            // (B, N, 2)
  Reals projections1, projections2;  // (B, 3, 4)
  int64_t batch, count;
  double least;  // below this share of a point's length w counts as 0: the point is at infinity
  Reals points;  // (B, N, 3)
};

KV_KERNEL(triangulate, Triangulate)

template <class T>
KV_HD void triangulate_of(Triangulate<T> const& p, int64_t i) {
  int64_t const b = i / p.count;
  double m[16] = {}, v[4];
  for (int view = 0; view < 2; ++view) {
    Reals const &points = view ? p.points2 : p.points1, &P = view ? p.projections2 : p.projections1;
    for (int axis = 0; axis < 2; ++axis) {
      double const x = points[2 * i + axis];
      double row[4];
      for (int k = 0; k < 4; ++k) row[k] = x * P[b * 12 + 8 + k] - P[b * 12 + 4 * axis + k];
      for (int k = 0; k < 4; ++k)
        for (int l = 0; l < 4; ++l) m[4 * k + l] += row[k] * row[l];
    }
  }
  small::smallest_eigenvector<4>(m, v);
  bool const there = small::magnitude(v[3]) > p.least;
  for (int k = 0; k < 3; ++k) p.points.set(3 * i + k, there ? v[k] / v[3] : small::nan());
}

}  // namespace kv
