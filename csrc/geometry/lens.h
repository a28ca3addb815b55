// Points to where a lens with distortion shows them,
//
//   (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + shift(x, y)
//
// for (x, y) on the plane z = 1 before the camera, r^2 = x^2 + y^2. Coefficients stand in the order k1, k2, p1, p2, k3,
// k4, k5, k6, s1, s2, s3, s4. And from there to where one without would show them: steps of a fixed-point iteration.
// Included by lens_cpu.cpp, lens.cu and lens_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv {

template <class T>
struct LensPoints {
  T const* points;           // (B, N, 2) in pixels
  T const *camera, *wanted;  // (3, 3) of the points and of the result
  T const* coefficients;     // (given): the first ones, others are 0
  T const* tilt;             // (3, 3), to the plane of a tilted sensor, or back from it; or null
  // From the numbers of a problem to the next one's: 0 where all have the same.
  int64_t camera_stride, wanted_stride, coefficients_stride, tilt_stride;
  int given, steps;
  int64_t batch, count;
  T* result;  // (B, N, 2)
};

KV_KERNEL(undistort, LensPoints)
KV_KERNEL(distort, LensPoints)

// A problem's lens.
template <class T>
struct Lens {
  LensPoints<T> const& p;
  T const *k, *wanted, *tilt;
  T c[12];

  KV_HD Lens(LensPoints<T> const& p, int64_t b)
      : p(p),
        k(p.camera + b * p.camera_stride),
        wanted(p.wanted + b * p.wanted_stride),
        tilt(p.tilt ? p.tilt + b * p.tilt_stride : nullptr) {
    for (int i = 0; i < 12; ++i) c[i] = i < p.given ? p.coefficients[b * p.coefficients_stride + i] : T(0);
  }
  template <class V>
  KV_HD void to_plane(V& x, V& y) const {
    x = (x - k[2]) / k[0];
    y = (y - k[5]) / k[4];
  }
  template <class V>
  KV_HD void to_pixels(V& x, V& y) const {
    x = x * wanted[0] + wanted[2];
    y = y * wanted[4] + wanted[5];
  }
  template <class V>
  KV_HD void turn(V& x, V& y) const {
    if (!tilt) return;
    V const w = x * tilt[6] + y * tilt[7] + tilt[8], u = (x * tilt[0] + y * tilt[1] + tilt[2]) / w;
    y = (x * tilt[3] + y * tilt[4] + tilt[5]) / w;
    x = u;
  }
  // The shift, and the factor before it as what is above a line and below it.
  template <class V>
  KV_HD void terms(V x, V y, V& above, V& below, V& dx, V& dy) const {
    V const r2 = x * x + y * y;
    above = 1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]));
    below = 1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7]));
    dx = 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x) + r2 * (c[8] + r2 * c[9]);
    dy = c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y + r2 * (c[10] + r2 * c[11]);
  }
  template <class V>
  KV_HD void undistort(V& x, V& y) const {
    to_plane(x, y);
    turn(x, y);
    V const x0 = x, y0 = y;
    for (int step = 0; step < p.steps; ++step) {
      V above, below, dx, dy;
      terms(x, y, above, below, dx, dy);
      V const inverse = below / above;
      x = (x0 - dx) * inverse;
      y = (y0 - dy) * inverse;
    }
    to_pixels(x, y);
  }
  template <class V>
  KV_HD void distort(V& x, V& y) const {
    V above, below, dx, dy;
    to_plane(x, y);
    terms(x, y, above, below, dx, dy);
    V const factor = above / below;
    x = x * factor + dx;
    y = y * factor + dy;
    turn(x, y);
    to_pixels(x, y);
  }
};

}  // namespace kv
