// The Hessian response of the levels of an octave on CUDA: that of feature/responses.h, whose sigmas are the blurs of
// the levels, as kernel arguments. On the CPU hessian_response itself serves. Included by hessian.cu and
// scale_space_features_op.cpp.
#pragma once

#include "feature/responses.h"

namespace kv::feature {

constexpr int kMaxScales = 32;

template <class T>
struct LevelHessian {
  Planes<T const> x;  // plane p is level p % scale_count
  Planes<T> y;
  bool sobel;                      // else central differences
  Compute<T> factors[kMaxScales];  // the fourth powers of the blurs
  int scale_count;

  KV_HD Compute<T> factor(int64_t plane) const { return factors[plane % scale_count]; }
};

KV_KERNEL(level_hessian, LevelHessian)  // CUDA

}  // namespace kv::feature
