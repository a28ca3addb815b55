// The kernels of motion blur: a line through the center of a square or a cube, rotated, with weights that change
// linearly along it. Each pixel of the kernel is rotated back and interpolates the weights of the line there:
//
//   weight = sum over taps of line(tap) w(along - tap)  times  w(across) for each other axis     w: of an interpolation
//
// The weights of a kernel are divided by their sum. They are computed in double, because the last bits of a coordinate
// can decide which of two pixels is nearest.
#pragma once

#include <math.h>

#include "core/isa.h"

namespace kv::filters {

enum class MotionTaps : int { nearest, bilinear, bicubic };

template <class T>
struct MotionKernel {
  T const *angle, *direction;              // (B or 1, axes == 3 ? 3 : 1) in degrees, and (B or 1, 1)
  int64_t angle_stride, direction_stride;  // 0 if all kernels share one
  int size, axes;
  MotionTaps taps;
  int64_t batch;
  T* kernels;  // (B, size, size), or (B, size, size, size)

  KV_HD int angles() const { return axes == 3 ? 3 : 1; }
  KV_HD int64_t count() const { return int64_t(size) * size * (axes == 3 ? size : 1); }
};

KV_KERNEL(motion_kernel, MotionKernel)

KV_HD double round_half_to_even(double x) {
  double const shift = x < 0 ? -0x1p52 : 0x1p52;
  return x + shift - shift;  // kernels are smaller than 2^52 pixels
}

// The line of one kernel.
struct MotionLine {
  double vector[3];  // of the rotation
  double cosine, sinc, versine;
  double start, change;  // the weight at the left end, and that at the right end minus it
  int size, center, axes;
  MotionTaps taps;

  KV_HD MotionLine(double const* degrees, double direction, int size, int axes, MotionTaps taps)
      : size(size), center(size / 2), axes(axes), taps(taps) {
    double square = 0;
    for (int i = 0; i < 3; ++i) {
      vector[i] = i < (axes == 2 ? 1 : 3) ? degrees[i] * (3.14159265358979323846 / 180) : 0;
      square += vector[i] * vector[i];
    }
    double const t = sqrt(square), half = t > 0 ? sin(t / 2) / t : 0.5;
    versine = 2 * half * half;
    sinc = t > 0 ? sin(t) / t : 1;
    cosine = 1 - square * versine;
    double const clamped = direction < -1 ? -1 : direction > 1 ? 1 : direction;
    start = (clamped + 1) / 2, change = 1 - 2 * start;
  }

  // The weight of a tap at a distance.
  KV_HD double tap_weight(double d) const {
    if (taps == MotionTaps::nearest) return d == 0 ? 1 : 0;
    if (taps == MotionTaps::bilinear) return d < 1 ? 1 - d : 0;
    if (d <= 1) return (1.25 * d - 2.25) * d * d + 1;
    return d < 2 ? ((-0.75 * d + 3.75) * d - 6) * d + 3 : 0;
  }
  // The nearest whole pixel. Halves, up to rounding errors, go to the even index, counted from the border.
  KV_HD double nearest_pixel(double position) const {
    return round_half_to_even(round_half_to_even(position * 0x1p20) / 0x1p20 + center) - center;
  }
  KV_HD double weight(int64_t i) const {
    double const x = double(i % size - center), y = double(i / size % size - center),
                 z = axes == 3 ? double(i / size / size - center) : 0;
    double at[3];
    if (axes == 2) {  // y points down: counter-clockwise on the screen
      double const sine = vector[0] * sinc;
      at[0] = cosine * x - sine * y, at[1] = sine * x + cosine * y, at[2] = 0;
    } else {  // Rodrigues' formula for the rotation vector -v
      double const *const v = vector, dot = versine * (v[0] * x + v[1] * y + v[2] * z);
      at[0] = cosine * x - sinc * (v[1] * z - v[2] * y) + dot * v[0];
      at[1] = cosine * y - sinc * (v[2] * x - v[0] * z) + dot * v[1];
      at[2] = cosine * z - sinc * (v[0] * y - v[1] * x) + dot * v[2];
    }
    if (taps == MotionTaps::nearest)
      for (int k = 0; k < 3; ++k) at[k] = nearest_pixel(at[k]);
    double const first = floor(at[0]);
    int const before = taps == MotionTaps::bicubic ? 1 : 0, after = taps == MotionTaps::nearest ? 0 : before + 1;
    double sum = 0;
    for (int k = -before; k <= after; ++k) {
      double const tap = first + k, distance = at[0] - tap;
      if (tap < -center || tap > center) continue;
      sum += (start + change * (tap + center) / (size - 1)) * tap_weight(distance < 0 ? -distance : distance);
    }
    for (int k = 1; k < axes; ++k) sum *= tap_weight(at[k] < 0 ? -at[k] : at[k]);
    return sum;
  }
};

// `read` converts an element to a number.
template <class T, class Read>
KV_HD MotionLine motion_line(MotionKernel<T> const& p, int64_t kernel, Read read) {
  double degrees[3];
  for (int i = 0; i < p.angles(); ++i) degrees[i] = double(read(p.angle[kernel * p.angle_stride + i]));
  return {degrees, double(read(p.direction[kernel * p.direction_stride])), p.size, p.axes, p.taps};
}

}  // namespace kv::filters
