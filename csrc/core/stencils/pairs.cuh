// Two numbers of 16 bits that are compared at once, on CUDA. Included by *.cu files of filters and of morphology.
#pragma once

#include "core/launch.cuh"
#include "core/nan_min_max.cuh"

namespace kv {
namespace {

// One instruction has the minima or maxima of two pairs from compute capability 8.0 on.
template <class T>
struct Pair {
  uint32_t bits;

  Pair() = default;  // Pair{} is a pair of zeros
  explicit __device__ __forceinline__ Pair(uint32_t bits) : bits(bits) {}
  __device__ __forceinline__ Pair(float first, float second) {
    T const numbers[] = {round_to<T>(first), round_to<T>(second)};
    __builtin_memcpy(&bits, numbers, 4);
  }
  __device__ __forceinline__ float operator[](int i) const {
    T numbers[2];
    __builtin_memcpy(numbers, &bits, 4);
    return read(numbers[i]);
  }
};
template <class T>
__device__ __forceinline__ Pair<T> lower(Pair<T> a, Pair<T> b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return Pair<T>(nan_min(a[0], b[0]), nan_min(a[1], b[1]));
#else
  uint32_t bits;
  if constexpr (__is_same(T, Half))
    asm("min.NaN.f16x2 %0, %1, %2;" : "=r"(bits) : "r"(a.bits), "r"(b.bits));
  else
    asm("min.NaN.bf16x2 %0, %1, %2;" : "=r"(bits) : "r"(a.bits), "r"(b.bits));
  return Pair<T>(bits);
#endif
}
template <class T>
__device__ __forceinline__ Pair<T> upper(Pair<T> a, Pair<T> b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return Pair<T>(nan_max(a[0], b[0]), nan_max(a[1], b[1]));
#else
  uint32_t bits;
  if constexpr (__is_same(T, Half))
    asm("max.NaN.f16x2 %0, %1, %2;" : "=r"(bits) : "r"(a.bits), "r"(b.bits));
  else
    asm("max.NaN.bf16x2 %0, %1, %2;" : "=r"(bits) : "r"(a.bits), "r"(b.bits));
  return Pair<T>(bits);
#endif
}

}  // namespace
}  // namespace kv
