// Points and normals of the pixels of depth images, by the camera's numbers fx, fy, cx, cy:
//
//   point(x, y) = d ray,  ray = ((x - cx) / fx, (y - cy) / fy, 1), over its length where depth is the distance
//   normal      = dx x dy over its length, the Sobel derivatives of the points, with the border replicated
//
// Included by depth_points_cpu.cpp, depth_points.cu and depth_points_op.cpp.
#pragma once

#include "core/images.h"
#include "core/isa.h"
#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif

namespace kv {

template <class T>
struct DepthPoints {
  Images<T const> depth;  // one channel
  Images<T> y;            // three
  Compute<T> const* cameras;
  int64_t camera_stride;  // 0 where one serves the batch
  bool distance;          // depth is the distance from the camera, not z
};

template <class T>
struct DepthPointsBackward {
  Images<T const> grad;
  Images<T> to_depth;
  Compute<T> const* cameras;
  int64_t camera_stride;
  bool distance;
};

KV_KERNEL(depth_points, DepthPoints)
KV_KERNEL(depth_points_backward, DepthPointsBackward)
KV_KERNEL(depth_normals, DepthPoints)

template <class V>
KV_HD V root_of(V x) {
#if defined(__CUDACC__)
  return ::sqrt(x);
#else
  return vsqrt(x);
#endif
}

template <class F>
struct Rays {
  F fx, fy, cx, cy;
  bool unit;

  KV_HD Rays(F const* k, bool unit) : fx(1 / k[0]), fy(1 / k[4]), cx(k[2]), cy(k[5]), unit(unit) {}
  template <class V>
  KV_HD void at(V x, F y, V (&ray)[3]) const {
    ray[0] = (x - cx) * fx;
    ray[1] = V{} + (y - cy) * fy;
    ray[2] = V{} + 1;
    if (!unit) return;
    V const scale = 1 / root_of(V(ray[0] * ray[0] + ray[1] * ray[1] + 1));
    for (int i = 0; i < 3; ++i) ray[i] = ray[i] * scale;
  }
};

// The normal of the points around, point(j, i)[k] being number k of the one i - 1 to the right and j - 1 below.
template <class V, class Point>
KV_HD void normal_of(Point point, V (&normal)[3]) {
  V p[3][3][3], along_x[3], along_y[3];
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) point(j, i, p[j][i]);
  for (int k = 0; k < 3; ++k) {
    along_x[k] = (p[0][2][k] - p[0][0][k]) + 2 * (p[1][2][k] - p[1][0][k]) + (p[2][2][k] - p[2][0][k]);
    along_y[k] = (p[2][0][k] - p[0][0][k]) + 2 * (p[2][1][k] - p[0][1][k]) + (p[2][2][k] - p[0][2][k]);
  }
  for (int k = 0; k < 3; ++k) {
    int const a = (k + 1) % 3, b = (k + 2) % 3;
    normal[k] = (along_x[a] * along_y[b] - along_x[b] * along_y[a]) * (1.f / 64);
  }
  V const length = root_of(V(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]));
  V const scale = 1 / max(length, V(V{} + 1e-12f));
  for (int k = 0; k < 3; ++k) normal[k] = normal[k] * scale;
}

}  // namespace kv
