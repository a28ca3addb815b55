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

namespace small {

// The point seen at `pixels`, (x, y) of one image and of the other, by projections (3, 4). NaN where it is at infinity.
KV_HD void triangulate(double const (*pixels)[2], double const (*projections)[12], double least, double* point) {
  double m[16] = {}, v[4];
  for (int view = 0; view < 2; ++view)
    for (int axis = 0; axis < 2; ++axis) {
      double const* const P = projections[view];
      double row[4];
      for (int k = 0; k < 4; ++k) row[k] = pixels[view][axis] * P[8 + k] - P[4 * axis + k];
      for (int k = 0; k < 4; ++k)
        for (int l = 0; l < 4; ++l) m[4 * k + l] += row[k] * row[l];
    }
  smallest_eigenvector<4>(m, v);
  bool const there = magnitude(v[3]) > least;
  for (int k = 0; k < 3; ++k) point[k] = there ? v[k] / v[3] : nan();
}

}  // namespace small

template <class T>
KV_HD void triangulate_of(Triangulate<T> const& p, int64_t i) {
  int64_t const b = i / p.count;
  double pixels[2][2], projections[2][12], point[3];
  for (int k = 0; k < 2; ++k) pixels[0][k] = p.points1[2 * i + k], pixels[1][k] = p.points2[2 * i + k];
  for (int k = 0; k < 12; ++k)
    projections[0][k] = p.projections1[12 * b + k], projections[1][k] = p.projections2[12 * b + k];
  small::triangulate(pixels, projections, p.least, point);
  for (int k = 0; k < 3; ++k) p.points.set(3 * i + k, point[k]);
}

}  // namespace kv
