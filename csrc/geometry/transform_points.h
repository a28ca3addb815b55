// Points transformed by homographies and cameras; one matrix serves many points.
//
//   transform   y = M (p, 1) without its last entry w, divided by w
//   project     y = f (px, py) / pz + c
//   unproject   y = d ray, ray = ((u - cx) / fx, (v - cy) / fy, 1), divided by its length if d is the distance
//   intersect   y = d / (n . ray), where the ray meets the plane n . p = d
//
// A divisor of magnitude up to 1e-8 is replaced by 1. That of `intersect` has magnitude eps at least and keeps its
// sign. Each map has a vjp to the point and to the matrix.
#pragma once

#include "core/isa.h"
#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif

namespace kv::geometry {

enum class PointMap { plane, space, image, project, unproject, intersect };

template <class T>
struct TransformPoints {
  T const *points, *depth;  // depth: for unproject only
  Compute<T> const* matrices;
  T* y;
  int64_t matrix_stride, count, total;  // count: points of a matrix; total: all points
  PointMap map;
  bool distance;
};

template <class T>
struct TransformPointsBackward {
  T const *grad, *points, *depth;
  Compute<T> const* matrices;
  T *grad_points, *grad_depth;
  Compute<T>*partial, *grad_matrix;  // (matrices, chunks, entries) and their sums; null without a gradient to matrices
  int64_t matrix_stride, count, matrices_count, part;  // part: points of a chunk, which one block or thread sums
  PointMap map;
  bool distance;

  KV_HD int64_t parts() const { return (count + part - 1) / part; }
};

KV_KERNEL(transform_points, TransformPoints)
KV_KERNEL(transform_points_backward, TransformPointsBackward)

// Returns 1 / z, or 1 if z is too small to divide by. `divides` is 1 or 0 accordingly.
template <class V>
KV_HD V divider(V z, V& divides) {
  V const one = V{} + 1, magnitude = z < 0 ? -z : z;
  divides = magnitude > V(V{} + 1e-8f) ? one : V{};
  return one / (magnitude > V(V{} + 1e-8f) ? z : one);
}
template <class V>
KV_HD V point_root(V x) {
#if defined(__CUDACC__)
  return ::sqrt(x);
#else
  return vsqrt(x);
#endif
}

// M is (Out + 1, In + 1).
template <int In, int Out>
struct Transform {
  static constexpr int in = In, out = Out, entries = (In + 1) * (Out + 1);

  template <class F, class V>
  KV_HD static V apply(F const* m, V const (&p)[In], V (&y)[Out], V& divides) {
    V inverse = V{};
    for (int r = Out; r >= 0; --r) {
      V sum = V{} + m[r * (In + 1) + In];
      for (int c = 0; c < In; ++c) sum = sum + p[c] * m[r * (In + 1) + c];
      if (r == Out)
        inverse = divider(sum, divides);
      else
        y[r] = sum * inverse;
    }
    return inverse;
  }
  template <class F, class V>
  KV_HD static void value(F const* m, bool, V const (&p)[In], V (&y)[Out]) {
    V divides;
    apply(m, p, y, divides);
  }
  template <class F, class V>
  KV_HD static void vjp(F const* m, bool, V const (&p)[In], V const (&g)[Out], V (&grad_p)[In], V (&grad_m)[entries]) {
    V y[Out], divides, row[Out + 1];
    V const inverse = apply(m, p, y, divides);
    row[Out] = V{};
    for (int r = 0; r < Out; ++r) {
      row[r] = g[r] * inverse;
      row[Out] = row[Out] - row[r] * y[r] * divides;
    }
    for (int c = 0; c < In; ++c) grad_p[c] = V{};
    for (int r = 0; r <= Out; ++r) {
      for (int c = 0; c < In; ++c) {
        grad_p[c] = grad_p[c] + row[r] * m[r * (In + 1) + c];
        grad_m[r * (In + 1) + c] = row[r] * p[c];
      }
      grad_m[r * (In + 1) + In] = row[r];
    }
  }
};

// The camera matrix of Project and Unproject is (fx . cx / . fy cy / . . .); the other entries are not read.
struct Project {
  static constexpr int in = 3, out = 2, entries = 9;

  template <class F, class V>
  KV_HD static void value(F const* k, bool, V const (&p)[3], V (&y)[2]) {
    V divides;
    V const inverse = divider(p[2], divides);
    y[0] = p[0] * inverse * k[0] + k[2];
    y[1] = p[1] * inverse * k[4] + k[5];
  }
  template <class F, class V>
  KV_HD static void vjp(F const* k, bool, V const (&p)[3], V const (&g)[2], V (&grad_p)[3], V (&grad_k)[9]) {
    V divides;
    V const inverse = divider(p[2], divides), x = p[0] * inverse, y = p[1] * inverse;
    grad_p[0] = g[0] * k[0] * inverse;
    grad_p[1] = g[1] * k[4] * inverse;
    grad_p[2] = -(grad_p[0] * x + grad_p[1] * y) * divides;
    for (int i = 0; i < 9; ++i) grad_k[i] = V{};
    grad_k[0] = g[0] * x, grad_k[2] = g[0];
    grad_k[4] = g[1] * y, grad_k[5] = g[1];
  }
};

// A point is (u, v, d).
struct Unproject {
  static constexpr int in = 3, out = 3, entries = 9;

  template <class F, class V>
  KV_HD static V ray(F const* k, bool distance, V const (&p)[3], V (&r)[2]) {
    r[0] = (p[0] - k[2]) / k[0];
    r[1] = (p[1] - k[5]) / k[4];
    return distance ? V(1 / point_root(V(r[0] * r[0] + r[1] * r[1] + 1))) : V(V{} + 1);
  }
  template <class F, class V>
  KV_HD static void value(F const* k, bool distance, V const (&p)[3], V (&y)[3]) {
    V r[2];
    V const z = ray(k, distance, p, r) * p[2];
    y[0] = r[0] * z, y[1] = r[1] * z, y[2] = z;
  }
  template <class F, class V>
  KV_HD static void vjp(F const* k, bool distance, V const (&p)[3], V const (&g)[3], V (&grad_p)[3], V (&grad_k)[9]) {
    V r[2];
    V const scale = ray(k, distance, p, r), z = scale * p[2], along = g[0] * r[0] + g[1] * r[1] + g[2];
    V const shortens = distance ? V(along * z * scale * scale) : V{};
    V const x = (g[0] * z - shortens * r[0]) / k[0], y = (g[1] * z - shortens * r[1]) / k[4];
    grad_p[0] = x, grad_p[1] = y, grad_p[2] = along * scale;
    for (int i = 0; i < 9; ++i) grad_k[i] = V{};
    grad_k[0] = -x * r[0], grad_k[2] = -x;
    grad_k[4] = -y * r[1], grad_k[5] = -y;
  }
};

// The matrix is one row: fx, fy, cx, cy, n, d, eps.
struct Meet {
  static constexpr int in = 2, out = 1, entries = 9;

  template <class F, class V>
  KV_HD static V along(F const* m, V const (&p)[2], V (&r)[2], V& varies) {
    r[0] = (p[0] - m[2]) / m[0];
    r[1] = (p[1] - m[3]) / m[1];
    V const one = V{} + 1, eps = V{} + m[8], depth_of = r[0] * m[4] + r[1] * m[5] + m[6];
    V const magnitude = depth_of < 0 ? -depth_of : depth_of;
    varies = magnitude < eps ? V{} : one;
    return magnitude < eps ? (depth_of < 0 ? -eps : eps) : depth_of;
  }
  template <class F, class V>
  KV_HD static void value(F const* m, bool, V const (&p)[2], V (&y)[1]) {
    V r[2], varies;
    y[0] = m[7] / along(m, p, r, varies);
  }
  template <class F, class V>
  KV_HD static void vjp(F const* m, bool, V const (&p)[2], V const (&g)[1], V (&grad_p)[2], V (&grad_m)[9]) {
    V r[2], varies;
    V const inverse = 1 / along(m, p, r, varies), grad_d = g[0] * inverse, grad_divisor = -grad_d * inverse * m[7];
    V const grad_along = grad_divisor * varies, grad_eps = grad_divisor - grad_along;
    grad_p[0] = grad_along * m[4] / m[0];
    grad_p[1] = grad_along * m[5] / m[1];
    grad_m[0] = -grad_p[0] * r[0], grad_m[1] = -grad_p[1] * r[1];
    grad_m[2] = -grad_p[0], grad_m[3] = -grad_p[1];
    grad_m[4] = grad_along * r[0], grad_m[5] = grad_along * r[1], grad_m[6] = grad_along;
    grad_m[7] = grad_d;
    grad_m[8] = inverse < 0 ? -grad_eps : grad_eps;
  }
};

// Calls f with the map.
template <class F>
KV_HD void with_map(PointMap map, F f) {
  switch (map) {
    case PointMap::plane:
      return f(Transform<2, 2>{});
    case PointMap::space:
      return f(Transform<3, 3>{});
    case PointMap::image:
      return f(Transform<3, 2>{});
    case PointMap::project:
      return f(Project{});
    case PointMap::intersect:
      return f(Meet{});
    default:
      return f(Unproject{});
  }
}

}  // namespace kv::geometry
