// Points in space from their pictures in two images: the null vectors of x P3 - P1, y P3 - P2 of both, P's rows being
// P1, P2, P3; and the gradient, whose sums over points are those of parts, then of all. Included by
// triangulation_cpu.cpp, triangulation.cu and triangulation_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv {

template <class T>
struct Triangulate {
  Reals points1, points2;            // (B, N, 2)
  Reals projections1, projections2;  // (B, 3, 4)
  int64_t batch, count;
  double least;  // below this share of a point's length w counts as 0: the point is at infinity
  Reals points;  // (B, N, 3)
  // For the gradient only:
  int64_t part;                                   // points that are summed first
  Reals grad, to1, to2;                           // (B, N, 3), (B, N, 2)
  Reals parts, to_projections1, to_projections2;  // (B, parts, 24), (B, 3, 4)

  KV_HD int64_t part_count() const { return (count + part - 1) / part; }
};

KV_KERNEL(triangulate, Triangulate)
KV_KERNEL(triangulate_backward, Triangulate)
KV_KERNEL(triangulate_sums, Triangulate)

namespace small {

// What is 0 for the point seen at `pixel` along an axis of an image of projection P (3, 4).
KV_HD void seen_row(double pixel, double const* P, int axis, double* row) {
  for (int k = 0; k < 4; ++k) row[k] = pixel * P[8 + k] - P[4 * axis + k];
}
KV_HD void seen_rows(double const (*pixels)[2], double const (*projections)[12], double* m) {
  for (int k = 0; k < 16; ++k) m[k] = 0;
  for (int view = 0; view < 2; ++view)
    for (int axis = 0; axis < 2; ++axis) {
      double row[4];
      seen_row(pixels[view][axis], projections[view], axis, row);
      for (int k = 0; k < 4; ++k)
        for (int l = 0; l < 4; ++l) m[4 * k + l] += row[k] * row[l];
    }
}

// The point seen at `pixels`, (x, y) of one image and of the other, by projections (3, 4). NaN where it is at infinity.
KV_HD void triangulate(double const (*pixels)[2], double const (*projections)[12], double least, double* point) {
  double m[16], v[4];
  seen_rows(pixels, projections, m);
  smallest_eigenvector<4>(m, v);
  bool const there = magnitude(v[3]) > least;
  for (int k = 0; k < 3; ++k) point[k] = there ? v[k] / v[3] : nan();
}

// From the gradient g to that point: to the pixels, and to both projections, to which it is added.
KV_HD void triangulate_vjp(double const (*pixels)[2], double const (*projections)[12], double least, double const* g,
                           double (*to_pixels)[2], double* to_projections) {
  double m[16], copy[16], v[4], to_v[4], u[4];
  seen_rows(pixels, projections, m);
  for (int k = 0; k < 16; ++k) copy[k] = m[k];
  smallest_eigenvector<4>(copy, v);
  bool const there = magnitude(v[3]) > least;
  to_v[3] = 0;
  for (int k = 0; k < 3; ++k) to_v[k] = g[k] / v[3], to_v[3] -= to_v[k] * v[k] / v[3];
  if (there) smallest_eigenvector_vjp<4>(m, v, to_v, u);
  for (int view = 0; view < 2; ++view)
    for (int axis = 0; axis < 2; ++axis) {
      to_pixels[view][axis] = 0;
      if (!there) continue;
      double row[4], by_v = 0, by_u = 0, *const to = to_projections + 12 * view;
      seen_row(pixels[view][axis], projections[view], axis, row);
      for (int k = 0; k < 4; ++k) by_v += row[k] * v[k], by_u += row[k] * u[k];
      for (int k = 0; k < 4; ++k) {
        double const slope = -(by_v * u[k] + by_u * v[k]);
        to_pixels[view][axis] += slope * projections[view][8 + k];
        to[8 + k] += slope * pixels[view][axis];
        to[4 * axis + k] -= slope;
      }
    }
}

}  // namespace small

template <class T>
KV_HD void read_pixels(Triangulate<T> const& p, int64_t i, double (*pixels)[2]) {
  for (int k = 0; k < 2; ++k) pixels[0][k] = p.points1[2 * i + k], pixels[1][k] = p.points2[2 * i + k];
}
template <class T>
KV_HD void read_projections(Triangulate<T> const& p, int64_t b, double (*projections)[12]) {
  for (int k = 0; k < 12; ++k)
    projections[0][k] = p.projections1[12 * b + k], projections[1][k] = p.projections2[12 * b + k];
}

template <class T>
KV_HD void triangulate_of(Triangulate<T> const& p, int64_t i) {
  double pixels[2][2], projections[2][12], point[3];
  read_pixels(p, i, pixels);
  read_projections(p, i / p.count, projections);
  small::triangulate(pixels, projections, p.least, point);
  for (int k = 0; k < 3; ++k) p.points.set(3 * i + k, point[k]);
}

// The gradients of a part of a problem's points.
template <class T, class Team>
KV_HD void triangulate_backward_of(Triangulate<T> const& p, int64_t item, Team team) {
  int64_t const b = item / p.part_count(), begin = (item - b * p.part_count()) * p.part;
  double projections[2][12], to_projections[24] = {};
  read_projections(p, b, projections);
  for (int64_t i = begin + team.first(); i < min(begin + p.part, p.count); i += team.step()) {
    int64_t const at = b * p.count + i;
    double pixels[2][2], g[3], to_pixels[2][2];
    read_pixels(p, at, pixels);
    for (int k = 0; k < 3; ++k) g[k] = p.grad[3 * at + k];
    small::triangulate_vjp(pixels, projections, p.least, g, to_pixels, to_projections);
    for (int k = 0; k < 2; ++k) p.to1.set(2 * at + k, to_pixels[0][k]), p.to2.set(2 * at + k, to_pixels[1][k]);
  }
  double const* const all = team.sums(to_projections);
  for (int k = team.first(); k < 24; k += team.step()) p.parts.set(24 * item + k, all[k]);
}

template <class T>
KV_HD void triangulate_sum(Triangulate<T> const& p, int64_t b, int k) {
  double sum = 0;
  for (int64_t part = 0; part < p.part_count(); ++part) sum += p.parts[24 * (b * p.part_count() + part) + k];
  (k < 12 ? p.to_projections1 : p.to_projections2).set(12 * b + k % 12, sum);
}

}  // namespace kv
