// Points to where a lens with distortion shows them,
//
//   (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + shift(x, y)
//
// for (x, y) on the plane z = 1 before the camera, r^2 = x^2 + y^2. Coefficients stand in the order k1, k2, p1, p2, k3,
// k4, k5, k6, s1, s2, s3, s4. And from there to where one without would show them: steps of a fixed-point iteration.
// Included by distortion_cpu.cpp, distortion.cu and distortion_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv {

template <class T>
struct LensPoints {
  T const* points;           // (B, N, 2) in pixels; or null: the pixels of an image of that width, results (B, 2, N)
  T const *camera, *wanted;  // (3, 3) of the points and of the result
  T const* coefficients;     // (given): the first ones, others are 0
  T const* tilt;             // (3, 3), to the plane of a tilted sensor, or back from it; or null
  // From the numbers of a problem to the next one's: 0 where all have the same.
  int64_t camera_stride, wanted_stride, coefficients_stride, tilt_stride;
  int given, steps;
  int64_t batch, count;
  T* result;  // (B, N, 2)
  int64_t width;
};

// The gradients of such a map to its lens, whose camera matrix is both that of the points and of the result: first sums
// for parts of the pixels of a sample, then these together.
constexpr int kLensSums = 25;  // focal lengths, center, 12 coefficients, tilt
constexpr int kLensPart = 4096;
inline int64_t lens_parts(int64_t count) { return (count + kLensPart - 1) / kLensPart; }

template <class T>
struct LensSlopes : LensPoints<T> {
  T const* grad;  // (B, 2, N)
  T* sums;        // (B, parts, kLensSums)
  int64_t parts;
  T *to_camera, *to_coefficients, *to_tilt;  // (B, 3, 3), (B, given), (B, 3, 3) or null

  KV_HD void set(int64_t b, int i, double sum) const {
    constexpr int entries[] = {0, 4, 2, 5};
    if (i < 4)
      to_camera[9 * b + entries[i]] = T(sum);
    else if (i >= 16 && to_tilt)
      to_tilt[9 * b + i - 16] = T(sum);
    else if (i < 16 && i - 4 < this->given)
      to_coefficients[this->given * b + i - 4] = T(sum);
  }
  // What has no part in the map.
  KV_HD void set_zeros(int64_t b) const {
    for (int i = 0; i < 9; ++i)
      if (i != 0 && i != 2 && i != 4 && i != 5) to_camera[9 * b + i] = 0;
    for (int i = 12; i < this->given; ++i) to_coefficients[this->given * b + i] = 0;
  }
};

KV_KERNEL(undistort, LensPoints)
KV_KERNEL(distort, LensPoints)
KV_KERNEL(lens_slopes, LensSlopes)
KV_KERNEL(lens_sums, LensSlopes)

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
  // Adds to the sums what a pixel whose place has the gradient (u, v) gives.
  template <class V>
  KV_HD void add_slopes(V x, V y, V u, V v, V (&to)[kLensSums]) const {
    auto const none = (u == 0) & (v == 0);  // wherever its place is
    x = none ? V(V{} + k[2]) : x;
    y = none ? V(V{} + k[5]) : y;
    to_plane(x, y);
    V above, below, dx, dy;
    terms(x, y, above, below, dx, dy);
    V const inverse = 1 / below, factor = above * inverse, on_x = x * factor + dx, on_y = y * factor + dy;
    V seen_x = on_x, seen_y = on_y;
    turn(seen_x, seen_y);
    to[0] += u * seen_x, to[1] += v * seen_y, to[2] += u, to[3] += v;
    V to_x = u * wanted[0], to_y = v * wanted[4];
    if (tilt) {
      V const scale = 1 / (on_x * tilt[6] + on_y * tilt[7] + tilt[8]),
              rows[] = {to_x * scale, to_y * scale, -(to_x * seen_x + to_y * seen_y) * scale};
      to_x = to_y = V{};
      for (int i = 0; i < 3; ++i) {
        to[16 + 3 * i] += rows[i] * on_x, to[17 + 3 * i] += rows[i] * on_y, to[18 + 3 * i] += rows[i];
        to_x += rows[i] * tilt[3 * i], to_y += rows[i] * tilt[3 * i + 1];
      }
    }
    V const r2 = x * x + y * y, r4 = r2 * r2;
    V const to_above = (to_x * x + to_y * y) * inverse, to_below = -to_above * factor;
    to[4] += to_above * r2, to[5] += to_above * r4, to[8] += to_above * r4 * r2;
    to[9] += to_below * r2, to[10] += to_below * r4, to[11] += to_below * r4 * r2;
    to[6] += to_x * (2 * x * y) + to_y * (r2 + 2 * y * y), to[7] += to_x * (r2 + 2 * x * x) + to_y * (2 * x * y);
    to[12] += to_x * r2, to[13] += to_x * r4, to[14] += to_y * r2, to[15] += to_y * r4;
    V const to_r2 = to_above * (c[0] + r2 * (2 * c[1] + 3 * c[4] * r2)) +
                    to_below * (c[5] + r2 * (2 * c[6] + 3 * c[7] * r2)) + to_x * (c[3] + c[8] + 2 * c[9] * r2) +
                    to_y * (c[2] + c[10] + 2 * c[11] * r2);
    V const back_x = (to_x * (factor + 2 * c[2] * y + 4 * c[3] * x) + 2 * c[3] * to_y * y + 2 * to_r2 * x) * (1 / k[0]);
    V const back_y = (to_y * (factor + 2 * c[3] * x + 4 * c[2] * y) + 2 * c[2] * to_x * x + 2 * to_r2 * y) * (1 / k[4]);
    to[0] -= back_x * x, to[1] -= back_y * y, to[2] -= back_x, to[3] -= back_y;
  }
};

}  // namespace kv
