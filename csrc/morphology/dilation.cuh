// What the files of dilation on CUDA share: dilation_3x3.cu has windows of 3 x 3 pixels, dilation_gradient.cu the
// gradient of others that are not too large, dilation.cu whatever else there is. Whether a window is flat is known on
// the device only, so each block looks.
#pragma once

#include "core/launch.cuh"
#include "dilation.h"

namespace kv::cuda {
namespace {

template <class F>
__device__ __forceinline__ F minus_infinity() {
  return -F(__int_as_float(0x7f800000));
}

// larger() in one instruction where there is one.
__device__ __forceinline__ float join(float a, float b) {
#if __CUDA_ARCH__ >= 800
  float most;
  asm("max.NaN.f32 %0, %1, %2;" : "=f"(most) : "f"(a), "f"(b));
  return most;
#else
  return larger(a, b);
#endif
}
__device__ __forceinline__ double join(double a, double b) { return larger(a, b); }
template <class F>
__device__ __forceinline__ Ties<F> join(Ties<F> const& a, Ties<F> const& b) {
  F const most = join(a.most, b.most), count = a.most == most ? a.count : F(0);
  return {most, b.most == most ? count + b.count : count};
}

__device__ __forceinline__ float share(float g, float count) { return __fdividef(g, fmaxf(count, 1.f)); }
__device__ __forceinline__ double share(double g, double count) { return g / fmax(count, 1.); }

}  // namespace

// Windows for which is_3x3 holds, over planar images.
template <class T>
int dilation_3x3(Dilation<T> const& p, CUstream_st* stream);
template <class T>
int dilation_3x3_backward(DilationBackward<T> const& p, CUstream_st* stream);
// Windows for which has_own_memory holds, over planar images.
template <class T>
int dilation_gradient(DilationBackward<T> const& p, CUstream_st* stream);

}  // namespace kv::cuda
