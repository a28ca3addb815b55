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

// Two bytes, in the upper halves of 16 bits. The bits below decide only which of two equal bytes is taken.
template <>
struct Pair<uint8_t> {
  uint32_t bits;
  Pair() = default;
  explicit __device__ __forceinline__ Pair(uint32_t bits) : bits(bits) {}
  __device__ __forceinline__ Pair(float first, float second)
      : bits(round_to<uint8_t>(first) << 8 | uint32_t(round_to<uint8_t>(second)) << 24) {}
  __device__ __forceinline__ float operator[](int i) const { return byte_of<float>(bits, 1 + 2 * i); }
};
using BytePair = Pair<uint8_t>;
__device__ __forceinline__ BytePair lower(BytePair a, BytePair b) { return BytePair(__vminu2(a.bits, b.bits)); }
__device__ __forceinline__ BytePair upper(BytePair a, BytePair b) { return BytePair(__vmaxu2(a.bits, b.bits)); }

// Of three; one instruction from compute capability 9.0 on, which the compiler finds by itself for half types.
template <class T>
__device__ __forceinline__ Pair<T> upper(Pair<T> a, Pair<T> b, Pair<T> c) {
  return upper(upper(a, b), c);
}
__device__ __forceinline__ BytePair lower(BytePair a, BytePair b, BytePair c) {
  return BytePair(__vimin3_u16x2(a.bits, b.bits, c.bits));
}
__device__ __forceinline__ BytePair upper(BytePair a, BytePair b, BytePair c) {
  return BytePair(__vimax3_u16x2(a.bits, b.bits, c.bits));
}

}  // namespace
}  // namespace kv
