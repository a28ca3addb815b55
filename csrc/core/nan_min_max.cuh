// Minimum and maximum that are NaN if either number is. Included by *.cu files and by what they share with the CPU.
#pragma once

namespace kv {
namespace {

// One instruction from compute capability 8.0 on.
__device__ __forceinline__ float nan_min(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return a < b || a != a ? a : b;
#else
  float y;
  asm("min.NaN.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
#endif
}
__device__ __forceinline__ float nan_max(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return a > b || a != a ? a : b;
#else
  float y;
  asm("max.NaN.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
#endif
}

__device__ __forceinline__ double nan_max(double a, double b) { return b <= a ? a : a == a ? b : a; }
__device__ __forceinline__ double nan_min(double a, double b) { return -nan_max(-a, -b); }

}  // namespace
}  // namespace kv
