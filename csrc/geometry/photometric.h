// How far an image, warped by a homography, is from another one, and the gradient of that to the homography, in one
// pass over both: the mean over the pixels (x, y) of the target whose place in the source lies between four pixels, and
// over channels, of
//
//   l1           |r|                        r = source(place) - target(x, y), bilinear
//   l2           r^2
//   charbonnier  sqrt(r^2 + eps^2)
//
// Which pixels these are counts as constant for the gradient. Included by photometric_cpu.cpp, photometric.cu and
// photometric_op.cpp.
#pragma once

#include "sample.h"

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
  Places<T> places;
  double const* sums;
  int64_t parts, batch, channels;
  T *loss, *grad;  // (B), (B, 3, 3)
};

KV_KERNEL(photometric, Photometric)
KV_KERNEL(photometric_total, PhotometricTotal)

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

template <class T>
KV_HD void photometric_total_of(PhotometricTotal<T> const& p, int64_t b, double* sums) {
  double const terms = sums[10] * double(p.channels);
  p.loss[b] = T(sums[9] / terms);
  for (int i = 0; i < 9; ++i) sums[i] = terms > 0 ? sums[i] / terms : 0;  // a mean of nothing has no slope
  homography_vjp(p.places.matrices + b * p.places.matrix_stride, p.places.use, sums, p.grad + b * 9);
}

}  // namespace kv
