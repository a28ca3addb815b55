// Points from where a lens with distortion shows them to where one without would: steps of a fixed-point iteration on
//
//   (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + shift(x, y)
//
// for (x, y) on the plane z = 1 before the camera, r^2 = x^2 + y^2. Coefficients stand in the order k1, k2, p1, p2, k3,
// k4, k5, k6, s1, s2, s3, s4. Included by undistort_cpu.cpp, undistort.cu and undistort_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv {

template <class T>
struct Undistort {
  T const* points;   // (B, N, 2) in pixels
  T const* cameras;  // (B, 29): fx, fy, cx, cy of the points; likewise of the result; 12 coefficients; a 3 x 3 matrix
                     // from the plane of a tilted sensor, used where there is a tilt
  int64_t batch, count;
  int steps;
  bool tilted;
  T* result;  // (B, N, 2)
};

constexpr int kCameraNumbers = 29;

KV_KERNEL(undistort, Undistort)

template <class V, class T>
KV_HD void undistort_of(Undistort<T> const& p, T const* camera, V& x, V& y) {
  T const *const c = camera + 8, *const m = camera + 20;
  x = (x - camera[2]) / camera[0];
  y = (y - camera[3]) / camera[1];
  if (p.tilted) {
    V const w = x * m[6] + y * m[7] + m[8], u = (x * m[0] + y * m[1] + m[2]) / w;
    y = (x * m[3] + y * m[4] + m[5]) / w;
    x = u;
  }
  V const x0 = x, y0 = y;
  for (int step = 0; step < p.steps; ++step) {
    V const r2 = x * x + y * y;
    V const inverse = (1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7]))) / (1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4])));
    V const dx = 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x) + r2 * (c[8] + r2 * c[9]);
    V const dy = c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y + r2 * (c[10] + r2 * c[11]);
    x = (x0 - dx) * inverse;
    y = (y0 - dy) * inverse;
  }
  x = x * camera[4] + camera[6];
  y = y * camera[5] + camera[7];
}

}  // namespace kv
