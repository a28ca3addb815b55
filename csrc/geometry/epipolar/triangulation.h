// Triangulates points from their pixels in two images: null vectors of the rows x P3 - P1 and y P3 - P2 of both images,
// where P1, P2, P3 are the rows of a projection. Gradients to projections are sums over chunks of points, then over
// chunks.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

template <class T>
struct Triangulate {
  Reals points1, points2;            // (B, N, 2)
  Reals projections1, projections2;  // (B, 3, 4)
  int64_t batch, count;
  double min_weight;  // |w| below this fraction of a homogeneous point's length is 0: the point is at infinity; of the
                      // terms of a projection, that of the other center: the cameras have no baseline
  Reals points;       // (B, N, 3)
  // For the gradient only:
  int64_t chunk_size;                                      // points of a chunk
  Reals grad, grad_points1, grad_points2;                  // (B, N, 3), (B, N, 2)
  Reals chunk_sums, grad_projections1, grad_projections2;  // (B, chunks, 24), (B, 3, 4)

  KV_HD int64_t num_chunks() const { return (count + chunk_size - 1) / chunk_size; }
};

KV_KERNEL(triangulate, Triangulate)
KV_KERNEL(triangulate_backward, Triangulate)
KV_KERNEL(triangulate_sums, Triangulate)

namespace small {

// A row of the equations: its product with a point is 0 if P (3, 4) projects the point to `pixel` along an axis.
KV_HD void equation_row(double pixel, double const* P, int axis, double* row) {
  for (int k = 0; k < 4; ++k) row[k] = pixel * P[8 + k] - P[4 * axis + k];
}
KV_HD void equation_matrix(double const (*pixels)[2], double const (*projections)[12], double* m) {
  for (int k = 0; k < 16; ++k) m[k] = 0;
  for (int view = 0; view < 2; ++view)
    for (int axis = 0; axis < 2; ++axis) {
      double row[4];
      equation_row(pixels[view][axis], projections[view], axis, row);
      for (int k = 0; k < 4; ++k)
        for (int l = 0; l < 4; ++l) m[4 * k + l] += row[k] * row[l];
    }
}

// Whether the second camera projects the center of the first, which is orthogonal to the rows of its projection.
KV_HD bool has_baseline(double const (*projections)[12], double min_weight) {
  double const* const P = projections[0];
  double center[4];
  for (int k = 0; k < 4; ++k) {
    double minor[3][3];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) minor[i][j] = P[4 * i + j + (j >= k)];
    double normal[3];
    cross3(minor[1], minor[2], normal);
    center[k] = (k % 2 ? -1 : 1) * dot3(minor[0], normal);
  }
  bool has_baseline = false;
  for (int i = 0; i < 3; ++i) {
    double sum = 0, size = 0;
    for (int k = 0; k < 4; ++k) {
      double const term = projections[1][4 * i + k] * center[k];
      sum += term, size += magnitude(term);
    }
    has_baseline = has_baseline || magnitude(sum) > min_weight * size;
  }
  return has_baseline;
}

// The point that both projections (3, 4) take to `pixels`, (x, y) of each image. NaN where it is at infinity, and
// without a baseline.
KV_HD void triangulate(double const (*pixels)[2], double const (*projections)[12], double min_weight, double* point) {
  double m[16], v[4];
  equation_matrix(pixels, projections, m);
  smallest_eigenvector<4>(m, v);
  bool const is_defined = magnitude(v[3]) > min_weight && has_baseline(projections, min_weight);
  for (int k = 0; k < 3; ++k) point[k] = is_defined ? v[k] / v[3] : nan();
}

// From the gradient g to that point: sets the gradient to the pixels, and adds to the gradient of both projections.
KV_HD void triangulate_vjp(double const (*pixels)[2], double const (*projections)[12], double min_weight,
                           double const* g, double (*grad_pixels)[2], double* grad_projections) {
  double m[16], copy[16], v[4], grad_v[4], u[4];
  equation_matrix(pixels, projections, m);
  for (int k = 0; k < 16; ++k) copy[k] = m[k];
  smallest_eigenvector<4>(copy, v);
  bool const is_defined = magnitude(v[3]) > min_weight && has_baseline(projections, min_weight);
  grad_v[3] = 0;
  for (int k = 0; k < 3; ++k) grad_v[k] = g[k] / v[3], grad_v[3] -= grad_v[k] * v[k] / v[3];
  if (is_defined) smallest_eigenvector_vjp<4>(m, v, grad_v, u);
  for (int view = 0; view < 2; ++view)
    for (int axis = 0; axis < 2; ++axis) {
      grad_pixels[view][axis] = 0;
      if (!is_defined) continue;
      double row[4], by_v = 0, by_u = 0, *const grad_projection = grad_projections + 12 * view;
      equation_row(pixels[view][axis], projections[view], axis, row);
      for (int k = 0; k < 4; ++k) by_v += row[k] * v[k], by_u += row[k] * u[k];
      for (int k = 0; k < 4; ++k) {
        double const derivative = -(by_v * u[k] + by_u * v[k]);
        grad_pixels[view][axis] += derivative * projections[view][8 + k];
        grad_projection[8 + k] += derivative * pixels[view][axis];
        grad_projection[4 * axis + k] -= derivative;
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
KV_HD void triangulate_item(Triangulate<T> const& p, int64_t i) {
  double pixels[2][2], projections[2][12], point[3];
  read_pixels(p, i, pixels);
  read_projections(p, i / p.count, projections);
  small::triangulate(pixels, projections, p.min_weight, point);
  for (int k = 0; k < 3; ++k) p.points.set(3 * i + k, point[k]);
}

// The gradients of a chunk of a problem's points.
template <class T, class Group>
KV_HD void triangulate_chunk_vjp(Triangulate<T> const& p, int64_t chunk, Group group) {
  int64_t const b = chunk / p.num_chunks(), begin = (chunk - b * p.num_chunks()) * p.chunk_size;
  double projections[2][12], grad_projections[24] = {};
  read_projections(p, b, projections);
  for (int64_t i = begin + group.thread_rank(); i < min(begin + p.chunk_size, p.count); i += group.num_threads()) {
    int64_t const at = b * p.count + i;
    double pixels[2][2], g[3], grad_pixels[2][2];
    read_pixels(p, at, pixels);
    for (int k = 0; k < 3; ++k) g[k] = p.grad[3 * at + k];
    small::triangulate_vjp(pixels, projections, p.min_weight, g, grad_pixels, grad_projections);
    for (int k = 0; k < 2; ++k)
      p.grad_points1.set(2 * at + k, grad_pixels[0][k]), p.grad_points2.set(2 * at + k, grad_pixels[1][k]);
  }
  double const* const all = group.sums(grad_projections);
  for (int k = group.thread_rank(); k < 24; k += group.num_threads()) p.chunk_sums.set(24 * chunk + k, all[k]);
}

template <class T>
KV_HD void sum_chunks(Triangulate<T> const& p, int64_t b, int k) {
  double sum = 0;
  for (int64_t chunk = 0; chunk < p.num_chunks(); ++chunk) sum += p.chunk_sums[24 * (b * p.num_chunks() + chunk) + k];
  (k < 12 ? p.grad_projections1 : p.grad_projections2).set(12 * b + k % 12, sum);
}

}  // namespace kv::geometry
