// The photometric error between an image warped by a homography and a target, and its gradient with respect to the
// homography, in one pass over both. It is the mean over channels, and over the pixels (x, y) of the target whose
// sampling coordinates lie between four pixels of the source, of
//
//   l1           |r|                        r = source(coordinates) - target(x, y), bilinear
//   l2           r^2
//   charbonnier  sqrt(r^2 + eps^2)
//
// The set of these pixels is constant for the gradient. A second kernel computes the normal equations of a Gauss-Newton
// step for the homography's first eight entries.
#pragma once

#include "geometry/transform/sampling.h"

namespace kv::geometry {

enum class Distance : int { l1, l2, charbonnier };

constexpr int kPhotometricSums = 11;  // nine of the gradient, the sum of errors, the number of pixels

template <class T>
struct Photometric : Sampling<T> {
  Images<T const> source, target;
  Distance distance;
  Compute<T> eps;
  double* sums;  // (B, parts, 11)
  int64_t parts;
};

// Adds up the parts. NaN where no pixel of the target is in the source.
template <class T>
struct PhotometricTotal {
  SampleCoords<T> coords;
  double const* sums;
  int64_t parts, batch, channels;
  T *loss, *grad;  // (B), (B, 3, 3)
};

// The sums of the normal equations. Let w be the weight with which w r is the derivative of the error. The mean over
// channels of w (d r / d coords) (d r / d coords)^T is a symmetric (2, 2). By (1, 0, -u) and (0, 1, -v) it becomes a
// (3, 3) for the rows of the matrix. Its six entries times those of (x, y, 1)^T (x, y, 1) are summed. Then follow nine
// sums of the gradient, the errors and the number of pixels. Coordinates are the caller's, (x, y) and (u, v) of the
// source.
constexpr int kNormalSums = 47;

template <class T>
struct PhotometricNormalEquations : Photometric<T> {
  T x_scale, x_offset, y_scale, y_offset;  // target coordinates are scale * pixel + offset
  T u_scale, u_offset, v_scale, v_offset;  // source coordinates likewise
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

// The error of a residual and its derivative; for l1 both are 0 at 0.
template <class V, class F>
KV_HD V distance_of(Distance distance, V r, F eps, V& derivative) {
  V const zero{};
  if (distance == Distance::l2) {
    derivative = r * 2;
    return r * r;
  }
  V const square = r * r + (distance == Distance::l1 ? F(0) : eps * eps);
  if (distance == Distance::l1) {
    derivative = r > 0 ? zero + 1 : r < 0 ? zero - 1 : r;
    return r * derivative;
  }
#if defined(__CUDACC__)
  V const root = ::sqrt(square);
#else
  V const root = vsqrt(square);
#endif
  derivative = r / root;
  return root;
}

// The weight with which weight * r is the derivative: iteratively reweighted least squares.
template <class V, class F>
KV_HD V weight_of(Distance distance, V r, F eps) {
  V const zero{}, one = zero + 1;
  if (distance == Distance::l2) return one + 1;
  V const size = r < 0 ? V(-r) : r, min_size = zero + eps;
#if defined(__CUDACC__)
  return one / (distance == Distance::l1 ? (size > min_size ? size : min_size) : ::sqrt(r * r + eps * eps));
#else
  return one / (distance == Distance::l1 ? (size > min_size ? size : min_size) : vsqrt(V(r * r + eps * eps)));
#endif
}

// The contribution of a pixel to the rows, from its (2, 2), xx, xy, yy, and w r d r / d coords.
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
  for (int i = 0; i < 9; ++i) sums[i] = terms > 0 ? sums[i] / terms : 0;  // an empty mean has no gradient
  homography_vjp(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use, sums, p.grad + b * 9);
}

}  // namespace kv::geometry
