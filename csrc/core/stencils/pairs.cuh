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
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
constexpr bool kComparesPairs = false;
#else
constexpr bool kComparesPairs = true;
#endif
#define KV_COMPARE_PAIRS(name, of_numbers, instruction)                                          \
  template <class T>                                                                             \
  __device__ __forceinline__ Pair<T> name(Pair<T> a, Pair<T> b) {                                \
    Pair<T> result;                                                                              \
    if constexpr (!kComparesPairs)                                                               \
      result = Pair<T>(of_numbers(a[0], b[0]), of_numbers(a[1], b[1]));                          \
    else if constexpr (__is_same(T, Half))                                                       \
      asm(instruction ".NaN.f16x2 %0, %1, %2;" : "=r"(result.bits) : "r"(a.bits), "r"(b.bits));  \
    else                                                                                         \
      asm(instruction ".NaN.bf16x2 %0, %1, %2;" : "=r"(result.bits) : "r"(a.bits), "r"(b.bits)); \
    return result;                                                                               \
  }
KV_COMPARE_PAIRS(lower, nan_min, "min")
KV_COMPARE_PAIRS(upper, nan_max, "max")
#undef KV_COMPARE_PAIRS

}  // namespace
}  // namespace kv
