// How kernels of frames read codes.
#pragma once

#include "core/launch.cuh"
#include "core/nan_min_max.cuh"
#include "frames.h"

namespace kv::color::cuda {
namespace {

// By an or and a subtraction: the conversion instruction has a quarter of their rate.
template <class S>
__device__ __forceinline__ auto number_of(S code) {
  if constexpr (__is_same(S, uint8_t) || __is_same(S, uint16_t))
    return __uint_as_float(0x4b000000u | uint32_t(code)) - 8388608.f;
  else
    return read(code);
}

template <class S, class T>
struct Reader {
  PlanesToRgb<T> const& p;
  int64_t frame;
  __device__ __forceinline__ Compute<T> operator()(int plane, int row, int column) const {
    return Compute<T>(number_of(p.planes[plane].template row<S>(frame, row)[column * p.planes[plane].column_stride]));
  }
};

// A color of a sum of weights of 1.
template <class F>
__device__ __forceinline__ F channel_of(FrameColors<F> const& colors, int k, F y, F u, F v) {
  return nan_min(nan_max(colors.linear(k, y, u, v, F(1)), colors.lowest[k]), colors.highest[k]);
}

}  // namespace
}  // namespace kv::color::cuda
