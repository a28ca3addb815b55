// The Hessian response of the levels of an octave: the determinant of the second derivatives of
// filters/edges/spatial_gradient.h, times the fourth power of the level's blur. Included by hessian_cpu.cpp, hessian.cu
// and scale_space_features_op.cpp.
#pragma once

#include "filters/edges/spatial_gradient.h"

namespace kv::feature {

constexpr int kMaxScales = 32;

template <class T>
struct LevelHessian {
  Planes<T const> x;  // plane p is level p % scale_count
  Planes<T> y;
  filters::DerivativeKind kind;
  Compute<T> factors[kMaxScales];
  int scale_count;

  KV_HD Compute<T> factor(int64_t plane) const { return factors[plane % scale_count]; }
};

KV_KERNEL(level_hessian, LevelHessian)

// V is a number or lanes; d: xx, xy, yy.
template <class V, class F>
KV_HD V scaled_determinant(V const (&d)[3], F factor) {
  return (d[0] * d[2] - d[1] * d[1]) * factor;
}

}  // namespace kv::feature
