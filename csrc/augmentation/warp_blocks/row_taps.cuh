// The taps of bilinear warps that map rows to rows, as crops, flips and resizing do. Such warps are separable: each
// axis has taps of its own.
#pragma once

#include "core/launch.cuh"
#include "geometry/transform/taps.h"

namespace kv::augmentation::cuda {
namespace {

// Two pixels of an axis and the weight of the second one. Pixels out of bounds read the fill.
struct AxisTaps {
  int first, second;
  float t;

  AxisTaps() = default;
  __device__ __forceinline__ AxisTaps(geometry::Axis<float> const& an_axis, double x) {
    geometry::Axis<double> const axis{an_axis.size, an_axis.padding, an_axis.align_corners};
    double fraction;
    int const tap = geometry::first_tap<2, double>(geometry::near_image(axis, x), fraction);
    t = float(fraction);
    first = geometry::pixel_at(axis, tap);
    second = t == 0 ? first : geometry::pixel_at(axis, tap + 1);
  }
};

// u = scale x + offset along both axes.
struct RowMap {
  double scale[2], offset[2];

  // From the caller's matrix. Crops, flips and resizing have diagonal matrices with a translation. Their inverse takes
  // a tenth of the instructions of a general one, and all threads wait for it; the result is the same.
  template <class F>
  __device__ __forceinline__ void init(F const* entries, geometry::MatrixUse const& use) {
    double m[9];
    geometry::matrix::load(entries, use.rows, m);
    double const x = m[0], y = m[4], determinant = x * y, from_x = m[2] * y, from_y = x * m[5];
    double const largest = fmax(fmax(fmax(fabs(x), fabs(y)), fabs(determinant)), fmax(fabs(from_x), fabs(from_y)));
    bool const diagonal = m[1] == 0 && m[3] == 0 && m[6] == 0 && m[7] == 0 && m[8] == 1;
    if (use.inverse && !use.normalized && diagonal && fabs(determinant) > 1e-6 * largest) {
      double const inverse = 1 / determinant;
      scale[0] = y * inverse;
      offset[0] = -from_x * inverse;
      scale[1] = x * inverse;
      offset[1] = -from_y * inverse;
      return;
    }
    geometry::Homography<double> const map = geometry::homography(entries, use);
    for (int i = 0; i < 2; ++i) {
      scale[i] = map.m[4 * i] / map.m[8];
      offset[i] = map.m[3 * i + 2] / map.m[8];
    }
  }
  __device__ __forceinline__ double at(int axis, int x) const { return scale[axis] * x + offset[axis]; }
};

}  // namespace
}  // namespace kv::augmentation::cuda
