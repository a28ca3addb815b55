// Points and normals of the pixels of depth images, for cameras fx, fy, cx, cy:
//
//   point(x, y) = d ray      ray = ((x - cx) / fx, (y - cy) / fy, 1), divided by its length if depth is the distance
//   normal = dx x dy         divided by its length; dx, dy are Sobel derivatives of the points with replicated border
//
// The gradient of normals goes first to the derivatives at each pixel, then from the derivatives around a pixel to its
// point. The gradient to the camera follows from that to the points, summed over the pixels of chunks, then over
// chunks.
#pragma once

#include "core/images.h"
#include "core/isa.h"
#include "core/matrix3.h"
#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif

namespace kv::geometry {

template <class T>
struct DepthPoints {
  Images<T const> depth;  // one channel
  Images<T> y;            // three channels
  Compute<T> const* cameras;
  int64_t camera_stride;  // 0 if all images share one
  bool distance;          // whether depth is the distance from the camera, not z
};

template <class T>
struct DepthPointsBackward {
  Images<T const> grad;
  Images<T> grad_depth;
  Compute<T> const* cameras;
  int64_t camera_stride;
  bool distance;
};

template <class T>
struct DepthNormalsBackward {
  Images<T const> grad, depth;
  Images<T> to;  // gradient to depth, or to points: three channels
  Compute<T> const* cameras;
  int64_t camera_stride;
  bool distance, to_points;
};

// The gradient to the cameras, from that to the points.
template <class T>
struct DepthPointsCameraBackward {
  Images<T const> grad, depth;
  Compute<T> const* cameras;
  int64_t camera_stride;
  bool distance;
  int64_t parts;            // chunks of an image: of groups of pixels on CUDA, rows on the CPU
  double* partial;          // (B, chunks, 4)
  Compute<T>* grad_camera;  // (B, 3, 3), set by the CUDA kernel; on the CPU the operator sums them
};

KV_KERNEL(depth_points, DepthPoints)
KV_KERNEL(depth_points_backward, DepthPointsBackward)
KV_KERNEL(depth_normals, DepthPoints)
KV_KERNEL(depth_normals_backward, DepthNormalsBackward)
KV_KERNEL(depth_points_camera_backward, DepthPointsCameraBackward)

template <class V>
KV_HD V inverse_root(V x) {
#if defined(__CUDACC__)
  return ::rsqrt(x);
#else
  return 1 / vsqrt(x);
#endif
}

template <class F>
struct Rays {
  F fx, fy, cx, cy;
  bool unit;

  KV_HD Rays(F const* k, bool unit) : fx(1 / k[0]), fy(1 / k[4]), cx(k[2]), cy(k[5]), unit(unit) {}
  // The first coordinate of a pixel's ray at z = 1, and the second one.
  template <class V>
  KV_HD V across(V x) const {
    return (x - cx) * fx;
  }
  KV_HD F down(F y) const { return (y - cy) * fy; }
  // The z of the point at depth d whose ray at z = 1 is (u, v, 1).
  template <class V>
  KV_HD V z_of(V u, F v, V d) const {
    return unit ? V(d * inverse_root(V(u * u + (v * v + 1)))) : d;
  }
  template <class V>
  KV_HD void at(V x, F y, V (&ray)[3]) const {
    V const u = across(x), z = z_of(u, down(y), V(V{} + 1));
    ray[0] = u * z;
    ray[1] = down(y) * z;
    ray[2] = z;
  }
  // Adds to sums for the gradient to the camera, from the gradient g to the point d ray. The gradients to fx and cx are
  // -fx times sums 0 and 2, those to fy and cy are -fy times sums 1 and 3, where fx and fy are the stored reciprocals.
  template <class V>
  KV_HD void add_gradients(V x, F y, V d, V const (&g)[3], V (&sums)[4]) const {
    V const u = across(x), v = V{} + down(y), z = z_of(u, down(y), V(V{} + 1));
    V const along = unit ? V((g[0] * u + g[1] * v + g[2]) * z * z) : V{};
    V const grad_u = d * z * (g[0] - along * u), grad_v = d * z * (g[1] - along * v);
    sums[0] = sums[0] + grad_u * u, sums[1] = sums[1] + grad_v * v;
    sums[2] = sums[2] + grad_u, sums[3] = sums[3] + grad_v;
  }
  KV_HD void store_gradients(double const* sums, F* grad_camera) const {
    for (int i = 0; i < 9; ++i) grad_camera[i] = 0;
    grad_camera[0] = F(-fx * sums[0]), grad_camera[4] = F(-fy * sums[1]);
    grad_camera[2] = F(-fx * sums[2]), grad_camera[5] = F(-fy * sums[3]);
  }
};

// Three vertically adjacent points (u z, v z, z), each with its v and z: their mean, weighted 1, 2, 1, and the last
// point minus the first.
template <class V>
struct PointColumn {
  V mean[3], difference[3];

  template <class F>
  KV_HD PointColumn(V u, F const (&v)[3], V const (&z)[3]) {
    V const first = v[0] * z[0], last = v[2] * z[2];
    mean[2] = z[0] + 2 * z[1] + z[2];
    difference[2] = z[2] - z[0];
    mean[0] = u * mean[2];
    difference[0] = u * difference[2];
    mean[1] = first + 2 * v[1] * z[1] + last;
    difference[1] = last - first;
  }
};

// Eight times the Sobel derivatives, from three columns of points.
template <class V>
KV_HD void tangents_of(PointColumn<V> const& left, PointColumn<V> const& middle, PointColumn<V> const& right,
                       V (&along_x)[3], V (&along_y)[3]) {
  for (int k = 0; k < 3; ++k) {
    along_x[k] = right.mean[k] - left.mean[k];
    along_y[k] = left.difference[k] + 2 * middle.difference[k] + right.difference[k];
  }
}

// The largest factor that normal_of multiplies by. It returns the factor.
constexpr float kSteepest = 1e12f;

template <class V>
KV_HD V normal_of(V const (&along_x)[3], V const (&along_y)[3], V (&normal)[3]) {
  cross3(along_x, along_y, normal);
  for (int k = 0; k < 3; ++k) normal[k] = normal[k] * (1.f / 64);
  V const scale = min(inverse_root(dot3(normal, normal)), V(V{} + kSteepest));
  for (int k = 0; k < 3; ++k) normal[k] = normal[k] * scale;
  return scale;
}
template <class V>
KV_HD void normal_vjp(V const (&along_x)[3], V const (&along_y)[3], V const (&grad)[3], V (&grad_x)[3],
                      V (&grad_y)[3]) {
  V normal[3], g[3];
  V const scale = normal_of(along_x, along_y, normal);
  V const along = scale < V(V{} + kSteepest) ? dot3(normal, grad) : V{};
  for (int k = 0; k < 3; ++k) g[k] = (grad[k] - normal[k] * along) * (scale * (1.f / 64));
  cross3(along_y, g, grad_x);
  cross3(g, along_x, grad_y);
}

// The coefficients of the point at i in the derivatives at i - 1, i, i + 1 along an axis: in their differences and in
// their means. At the border the replicated points count, too.
template <class F>
struct Taken {
  F difference[3], mean[3];
  KV_HD Taken(int64_t i, int64_t size) : difference{1, 0, -1}, mean{1, 2, 1} {
    if (i == 0) difference[1] -= 1, mean[1] += 1;
    if (i == size - 1) difference[1] += 1, mean[1] += 1;
  }
};

}  // namespace kv::geometry
