// How far several images, warped by the depth of another one, are from it, and the gradients of that to depth and
// projections, in one pass over all: the mean over the views of a sample and the pixels of its target whose place in
// the view lies between four pixels, and over channels, of a distance; transform/photometric.h has these, warp.h the
// places.
//
// Which pixels these are counts as constant for the gradient. Included by photometric_cpu.cpp,
// photometric.cu and photometric_op.cpp.
#pragma once

#include "geometry/depth/warp.h"
#include "geometry/transform/photometric.h"

namespace kv {

template <class T>
struct PhotometricDepth : DepthPlaces<T> {  // x is the first view of each sample
  Images<T const> target;
  int64_t view_stride, projection_view_stride;
  int views;
  Distance distance;
  Compute<T> eps;
  Compute<T>* to_depth;  // (B, h, w), of the sum
  double* sums;          // (B, parts, views, 14)
  int64_t parts;

  // A view as a source by itself.
  KV_HD DepthPlaces<T> view(int i) const {
    DepthPlaces<T> p = *this;
    p.x.data += i * view_stride;
    p.projections += i * projection_view_stride;
    return p;
  }
};

KV_KERNEL(photometric_depth, PhotometricDepth)

}  // namespace kv
