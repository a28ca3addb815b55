// SIMD arithmetic on bytes. load and store of lanes.h convert them to float; these keep integers. Included by *_cpu.cpp
// files.
#pragma once

#include "lanes.h"

namespace kv {

constexpr int kByteLanes = kVectorBytes;

template <int N>
KV_HD Lanes<uint8_t, N> load_bytes(uint8_t const* p) {
  return *reinterpret_cast<Lanes<uint8_t, N> const*>(p);
}
template <int N>
KV_HD void store_bytes(uint8_t* p, Lanes<uint8_t, N> v) {
  *reinterpret_cast<Lanes<uint8_t, N>*>(p) = v;
}

// The language's ?: on vectors of unsigned bytes takes GCC several instructions.
template <class V>
KV_HD V min_bytes(V a, V b) {
#if defined(__x86_64__)
  if constexpr (sizeof(V) == 16) return (V)_mm_min_epu8((__m128i)a, (__m128i)b);
#if defined(__AVX2__)
  if constexpr (sizeof(V) == 32) return (V)_mm256_min_epu8((__m256i)a, (__m256i)b);
#endif
#if defined(__AVX512BW__)
  if constexpr (sizeof(V) == 64) return (V)_mm512_min_epu8((__m512i)a, (__m512i)b);
#endif
#endif
  return a < b ? a : b;
}
template <class V>
KV_HD V max_bytes(V a, V b) {
#if defined(__x86_64__)
  if constexpr (sizeof(V) == 16) return (V)_mm_max_epu8((__m128i)a, (__m128i)b);
#if defined(__AVX2__)
  if constexpr (sizeof(V) == 32) return (V)_mm256_max_epu8((__m256i)a, (__m256i)b);
#endif
#if defined(__AVX512BW__)
  if constexpr (sizeof(V) == 64) return (V)_mm512_max_epu8((__m512i)a, (__m512i)b);
#endif
#endif
  return a > b ? a : b;
}

// The high halves of 32-bit products a * b.
template <int N>
KV_HD Lanes<uint16_t, N> high_product(Lanes<uint16_t, N> a, uint16_t b) {
  using V = Lanes<uint16_t, N>;
#if defined(__x86_64__)
  if constexpr (N == 8) return (V)_mm_mulhi_epu16((__m128i)a, (__m128i)broadcast<N>(b));
#if defined(__AVX2__)
  if constexpr (N == 16) return (V)_mm256_mulhi_epu16((__m256i)a, (__m256i)broadcast<N>(b));
#endif
#if defined(__AVX512BW__)
  if constexpr (N == 32) return (V)_mm512_mulhi_epu16((__m512i)a, (__m512i)broadcast<N>(b));
#endif
#endif
  if constexpr (N == 1)
    return V(uint32_t(a) * b >> 16);
  else
    return __builtin_convertvector(__builtin_convertvector(a, Lanes<uint32_t, N>) * uint32_t(b) >> 16, V);
}

// Pixels stored as T in kernels that compute in numbers F: uint8_t or uint16_t for bytes, otherwise Compute<T>.
template <class F, class T>
constexpr int kLanesAs = sizeof(F) < 4 ? kVectorBytes / int(sizeof(F)) : kLanes<T>;

template <int N, class F, class T>
KV_HD Lanes<F, N> load_as(T const* p) {
  if constexpr (sizeof(F) >= 4)
    return load<N>(p);
  else if constexpr (N == 1)
    return F(*p);
  else if constexpr (__is_same(F, T))
    return *reinterpret_cast<Lanes<F, N> const*>(p);
  else
    return __builtin_convertvector(load_bytes<N>(p), Lanes<F, N>);
}
template <int N, class F, class T>
KV_HD void store_as(T* p, Lanes<F, N> v) {
  if constexpr (sizeof(F) >= 4)
    store<N>(p, v);
  else if constexpr (N == 1)
    *p = T(v);
  else if constexpr (__is_same(F, T))
    *reinterpret_cast<Lanes<F, N>*>(p) = v;
  else
    store_bytes<N>(p, __builtin_convertvector(v, Lanes<uint8_t, N>));
}

}  // namespace kv
