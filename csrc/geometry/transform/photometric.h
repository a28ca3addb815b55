// How far an image, warped by a homography, is from another one, and the gradient of that to the homography, in one
// pass over both: the mean over the pixels (x, y) of the target whose place in the source lies between four pixels, and
// over channels, of
//
//   l1           |r|                        r = source(place) - target(x, y), bilinear
//   l2           r^2
//   charbonnier  sqrt(r^2 + eps^2)
//
// Which pixels these are counts as constant for the gradient. Or, for a step of Gauss and Newton, the normal equations
// of the homography's first eight numbers. Included by photometric_cpu.cpp, photometric.cu and photometric_op.cpp.
#pragma once

#include "geometry/transform/sampling.h"

namespace kv {

enum class Distance : int { l1, l2, charbonnier };

constexpr int kPhotometricSums = 11;  // the gradient's nine, the distances', how many pixels

template <class T>
struct Photometric : Sampling<T> {
  Images<T const> source, target;
  Distance distance;
  Compute<T> eps;
  double* sums;  // (B, parts, 11)
  int64_t parts;
};

// Adds the parts up. NaN where no pixel of the target is in the source.
template <class T>
struct PhotometricTotal {
  SampleCoords<T> coords;
  double const* sums;
  int64_t parts, batch, channels;
  T *loss, *grad;  // (B), (B, 3, 3)
};

// For the normal equations: the mean over channels of w (d r / d place) (d r / d place)^T, with the weight w that makes
// w r the derivative of the distance, is a symmetric (2, 2); by (1, 0, -u) and (0, 1, -v) it becomes one (3, 3) for the
// lines of the matrix, whose six numbers are summed times those of (x, y, 1)^T (x, y, 1). Then the gradient's nine, the
// distances, how many pixels. All in the caller's coordinates, (x, y) of the target and (u, v) of the source.
constexpr int kNormalSums = 47;

template <class T>
struct PhotometricNormalEquations : Photometric<T> {
  T x_scale, x_offset, y_scale, y_offset;  // pixels of the target are scale * pixel + offset there
  T u_scale, u_offset, v_scale, v_offset;  // and those of the source
};

template <class T>
struct PhotometricNormalTotal {
  double const* sums;
  int64_t parts, batch, channels;
  T *loss, *gradient, *normal;  // (B), (B, 8), (B, 8, 8)
};

KV_KERNEL(photometric, Photometric)
KV_KERNEL(photometric_total, PhotometricTotal)
KV_KERNEL(photometric_normal_equations, PhotometricNormalEquations)
KV_KERNEL(photometric_normal_total, PhotometricNormalTotal)

// The distance and its derivative; both are 0 at 0 for l1.
template <class V, class F>
KV_HD V distance_of(Distance distance, V r, F eps, V& slope) {
  V const zero{};
  if (distance == Distance::l2) {
    slope = r * 2;
    return r * r;
  }
  V const square = r * r + (distance == Distance::l1 ? F(0) : eps * eps);
  if (distance == Distance::l1) {
    slope = r > 0 ? zero + 1 : r < 0 ? zero - 1 : r;
    return r * slope;
  }
#if defined(__CUDACC__)
  V const root = ::sqrt(square);
#else
  V const root = vsqrt(square);
#endif
  slope = r / root;
  return root;
}

// What makes weight * r the derivative: reweighted least squares.
template <class V, class F>
KV_HD V weight_of(Distance distance, V r, F eps) {
  V const zero{}, one = zero + 1;
  if (distance == Distance::l2) return one + 1;
  V const size = r < 0 ? V(-r) : r, least = zero + eps;
#if defined(__CUDACC__)
  return one / (distance == Distance::l1 ? (size > least ? size : least) : ::sqrt(r * r + eps * eps));
#else
  return one / (distance == Distance::l1 ? (size > least ? size : least) : vsqrt(V(r * r + eps * eps)));
#endif
}

// The lines' share of a pixel, from the (2, 2) of its place, xx, xy, yy, and w r d r / d place.
template <class V>
KV_HD void to_lines(V xx, V xy, V yy, V by_x, V by_y, V u, V v, V weight, V (&line)[6], V (&gradient)[3]) {
  V const zero{}, scale = (zero + 1) / weight, square = scale * scale;
  V const ux = u * xx + v * xy, uy = u * xy + v * yy;
  line[0] = xx * square;
  line[1] = xy * square;
  line[2] = zero - ux * square;
  line[3] = yy * square;
  line[4] = zero - uy * square;
  line[5] = (u * ux + v * uy) * square;
  gradient[0] = by_x * scale;
  gradient[1] = by_y * scale;
  gradient[2] = zero - (u * by_x + v * by_y) * scale;
}

template <class T>
KV_HD void photometric_normal_total_of(PhotometricNormalTotal<T> const& p, int64_t b, double const* sums) {
  constexpr int pairs[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  double const terms = sums[46] * double(p.channels);
  p.loss[b] = T(sums[45] / terms);
  for (int i = 0; i < 8; ++i) {
    p.gradient[b * 8 + i] = T(terms > 0 ? sums[36 + i] / terms : 0);
    for (int k = 0; k < 8; ++k)
      p.normal[(b * 8 + i) * 8 + k] = T(terms > 0 ? sums[6 * pairs[i / 3][k / 3] + pairs[i % 3][k % 3]] / terms : 0);
  }
}

template <class T>
KV_HD void photometric_total_of(PhotometricTotal<T> const& p, int64_t b, double* sums) {
  double const terms = sums[10] * double(p.channels);
  p.loss[b] = T(sums[9] / terms);
  for (int i = 0; i < 9; ++i) sums[i] = terms > 0 ? sums[i] / terms : 0;  // a mean of nothing has no slope
  homography_vjp(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use, sums, p.grad + b * 9);
}

}  // namespace kv
