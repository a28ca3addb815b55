// The photometric distance of several views, warped by the depth of a target image, from that target, and its gradients
// to depth and projections, in one pass. It is the mean of a distance (transform/photometric.h) over the views of a
// sample, over channels, and over the pixels of the target whose sampling coordinates (warp.h) lie between four pixels
// of the view.
//
// For the gradient, the set of these pixels is constant.
#pragma once

#include "geometry/depth/warp.h"
#include "geometry/transform/photometric.h"

namespace kv::geometry {

template <class T>
struct PhotometricDepth : DepthSampling<T> {  // x is the first view of each sample
  Images<T const> target;
  int64_t view_stride, projection_view_stride;
  int views;
  Distance distance;
  Compute<T> eps;
  Compute<T>* grad_depth;  // (B, h, w), gradient of the sum, not of the mean
  double* sums;            // (B, chunks, views, 14)
  int64_t parts;

  // View i as the only source.
  KV_HD DepthSampling<T> view(int i) const {
    DepthSampling<T> p = *this;
    p.x.data += i * view_stride;
    p.projections += i * projection_view_stride;
    return p;
  }
};

KV_KERNEL(photometric_depth, PhotometricDepth)

}  // namespace kv::geometry
