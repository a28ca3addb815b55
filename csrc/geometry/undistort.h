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
  T const* points;           // (B, N, 2) in pixels
  T const *camera, *wanted;  // (3, 3) of the points and of the result
  T const* coefficients;     // (given): the first ones, others are 0
  T const* tilt;             // (3, 3), takes the plane of a tilted sensor back; or null
  // From the numbers of a problem to the next one's: 0 where all have the same.
  int64_t camera_stride, wanted_stride, coefficients_stride, tilt_stride;
  int given, steps;
  int64_t batch, count;
  T* result;  // (B, N, 2)
};

KV_KERNEL(undistort, Undistort)

template <class V, class T>
KV_HD void undistort_of(Undistort<T> const& p, int64_t b, V& x, V& y) {
  T const *const k = p.camera + b * p.camera_stride, *const wanted = p.wanted + b * p.wanted_stride;
  T c[12];
  for (int i = 0; i < 12; ++i) c[i] = i < p.given ? p.coefficients[b * p.coefficients_stride + i] : T(0);
  x = (x - k[2]) / k[0];
  y = (y - k[5]) / k[4];
  if (p.tilt) {
    T const* const m = p.tilt + b * p.tilt_stride;
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
  x = x * wanted[0] + wanted[2];
  y = y * wanted[4] + wanted[5];
}

}  // namespace kv
