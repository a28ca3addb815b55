// The Hessian response of planar images on CUDA: that of feature/responses.h, or that of the levels of an octave, whose
// sigmas are the blurs of the levels, as kernel arguments.
#pragma once

#include "feature/responses.h"

namespace kv::feature {

constexpr int kMaxScales = 32;

template <class T>
struct LevelHessian {
  Planes<T const> x;
  Planes<T> y;
  bool sobel;                      // else central differences
  Compute<T> factors[kMaxScales];  // the fourth powers of the blurs; plane p is level p % scale_count
  int scale_count;                 // 0: the factors are those of `arguments`
  ResponseArguments<Compute<T>> arguments;

  KV_HD Compute<T> factor(int64_t plane) const {
    return scale_count > 0 ? factors[plane % scale_count] : arguments.scale_of(plane);
  }
};

KV_KERNEL(level_hessian, LevelHessian)  // CUDA

}  // namespace kv::feature
