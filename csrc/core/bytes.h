// SIMD arithmetic on bytes. load and store of lanes.h convert them to float; these keep integers. Included by *_cpu.cpp
// files.
#pragma once

#if defined(__ARM_NEON)
#include <arm_neon.h>
#endif

#include "lanes.h"

namespace kv {

constexpr int kByteLanes = kVectorBytes;

template <int N>
KV_HD Lanes<uint8_t, N> load_bytes(uint8_t const* p) {
  return read_lanes<N>(p);
}
template <int N>
KV_HD void store_bytes(uint8_t* p, Lanes<uint8_t, N> v) {
  write_lanes<N>(p, v);
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

// Processors permute bytes within parts of 16. This many parts make a vector, whose ints are kPartInts.
constexpr int kParts = kVectorBytes < 32 ? 1 : 2, kPartInts = 4 * kParts;

// 16 bytes from one address, or from each of two.
template <int Parts>
KV_HD Lanes<uint8_t, 16 * Parts> load_parts(uint8_t const* a, uint8_t const* b) {
  if constexpr (Parts == 1)
    return load_bytes<16>(a);
  else
    return __builtin_shufflevector(load_bytes<16>(a), load_bytes<16>(b), 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13,
                                   14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31);
}

// Bytes as numbers of 16 bits.
template <int N>
KV_HD Lanes<int16_t, N> to_words(Lanes<uint8_t, N> v) {
#if defined(__AVX2__)
  if constexpr (N == 16) return (Lanes<int16_t, N>)_mm256_cvtepu8_epi16((__m128i)v);
#endif
#if defined(__AVX512BW__)
  if constexpr (N == 32) return (Lanes<int16_t, N>)_mm512_cvtepu8_epi16((__m256i)v);
#endif
  if constexpr (N == 1)
    return v;
  else
    return __builtin_convertvector(v, Lanes<int16_t, N>);
}
template <int N>
KV_HD Lanes<int16_t, N> load_words(uint8_t const* p) {
  return to_words<N>(load_bytes<N>(p));
}

// Bytes as ints.
template <int N>
KV_HD Lanes<int32_t, N> load_ints(uint8_t const* p) {
#if defined(__AVX2__)
  if constexpr (N == 8) return (Lanes<int32_t, N>)_mm256_cvtepu8_epi32(_mm_loadl_epi64((__m128i const*)p));
#endif
  return __builtin_convertvector(load_words<N>(p), Lanes<int32_t, N>);
}

// a b / 2^15, rounded half up.
template <int N>
KV_HD Lanes<int16_t, N> rounded_product(Lanes<int16_t, N> a, Lanes<int16_t, N> b) {
  using V = Lanes<int16_t, N>;
#if defined(__SSSE3__)
  if constexpr (N == 8) return (V)_mm_mulhrs_epi16((__m128i)a, (__m128i)b);
#if defined(__AVX2__)
  if constexpr (N == 16) return (V)_mm256_mulhrs_epi16((__m256i)a, (__m256i)b);
#endif
#if defined(__AVX512BW__)
  if constexpr (N == 32) return (V)_mm512_mulhrs_epi16((__m512i)a, (__m512i)b);
#endif
#elif defined(__ARM_NEON)
  if constexpr (N == 8) return (V)vqrdmulhq_s16((int16x8_t)a, (int16x8_t)b);
#endif
  if constexpr (N == 1) {
    return V((int32_t(a) * b + 0x4000) >> 15);
  } else {
    using Product = Lanes<int32_t, N>;
    Product const product = __builtin_convertvector(a, Product) * __builtin_convertvector(b, Product);
    return __builtin_convertvector((product + 0x4000) >> 15, V);
  }
}

// The sums of two adjacent products, a[2 i] b[2 i] + a[2 i + 1] b[2 i + 1].
template <int N>
KV_HD Lanes<int32_t, N> pair_products(Lanes<int16_t, 2 * N> a, Lanes<int16_t, 2 * N> b) {
  using V = Lanes<int32_t, N>;
#if defined(__x86_64__)
  if constexpr (N == 4) return (V)_mm_madd_epi16((__m128i)a, (__m128i)b);
#if defined(__AVX2__)
  if constexpr (N == 8) return (V)_mm256_madd_epi16((__m256i)a, (__m256i)b);
#endif
#elif defined(__ARM_NEON)
  if constexpr (N == 4) {
    int16x8_t const x = (int16x8_t)a, y = (int16x8_t)b;
    return (V)vpaddq_s32(vmull_s16(vget_low_s16(x), vget_low_s16(y)), vmull_high_s16(x, y));
  }
#endif
  V sum;
  for (int i = 0; i < N; ++i) sum[i] = int32_t(a[2 * i]) * b[2 * i] + int32_t(a[2 * i + 1]) * b[2 * i + 1];
  return sum;
}

// Byte i of the result is byte index[i] of the same 16-byte group of v, or 0 where index[i] is kNoByte.
constexpr uint8_t kNoByte = 0x80;
template <class V>
KV_HD V permuted_bytes(V v, V index) {
#if defined(__SSSE3__)
  if constexpr (sizeof(V) == 16) return (V)_mm_shuffle_epi8((__m128i)v, (__m128i)index);
#if defined(__AVX2__)
  if constexpr (sizeof(V) == 32) return (V)_mm256_shuffle_epi8((__m256i)v, (__m256i)index);
#endif
#elif defined(__ARM_NEON)
  if constexpr (sizeof(V) == 16) return (V)vqtbl1q_u8((uint8x16_t)v, (uint8x16_t)index);
#endif
  V result;
  for (int i = 0; i < int(sizeof(V)); ++i) result[i] = index[i] == kNoByte ? 0 : v[(i & ~15) + index[i]];
  return result;
}

// Integers, clamped to bytes.
template <int N>
KV_HD void store_clamped(uint8_t* p, Lanes<int32_t, N> v) {
#if defined(__AVX2__)
  if constexpr (N == 8) {
    __m128i const words = _mm_packs_epi32(_mm256_castsi256_si128((__m256i)v), _mm256_extracti128_si256((__m256i)v, 1));
    return _mm_storel_epi64((__m128i*)p, _mm_packus_epi16(words, words));
  }
#endif
  v = v > 0 ? v : Lanes<int32_t, N>{};
  v = v < 255 ? v : Lanes<int32_t, N>{} + 255;
  if constexpr (N == 1)
    *p = uint8_t(v);
  else
    store_bytes<N>(p, __builtin_convertvector(v, Lanes<uint8_t, N>));
}

// The same of four vectors. Of every 16 bytes of the result the first four are from a, the next four from b and so on.
template <int N>
KV_HD Lanes<uint8_t, 4 * N> clamped_bytes(Lanes<int32_t, N> a, Lanes<int32_t, N> b, Lanes<int32_t, N> c,
                                          Lanes<int32_t, N> d) {
  using V = Lanes<uint8_t, 4 * N>;
#if defined(__x86_64__)
  if constexpr (N == 4)
    return (V)_mm_packus_epi16(_mm_packs_epi32((__m128i)a, (__m128i)b), _mm_packs_epi32((__m128i)c, (__m128i)d));
#if defined(__AVX2__)
  if constexpr (N == 8)
    return (V)_mm256_packus_epi16(_mm256_packs_epi32((__m256i)a, (__m256i)b),
                                  _mm256_packs_epi32((__m256i)c, (__m256i)d));
#endif
#endif
  Lanes<int32_t, N> const all[] = {a, b, c, d};
  uint8_t bytes[4][N];
  V result;
  for (int k = 0; k < 4; ++k) store_clamped<N>(bytes[k], all[k]);
  for (int i = 0; i < 4 * N; ++i) result[i] = bytes[i / 4 % 4][i / 16 * 4 + i % 4];
  return result;
}

#if defined(__AVX512BW__)
// Maps whole vectors by a table of 256 values, of which one instruction of AVX-512 VBMI chooses among 128. Returns
// their bytes. The instruction set of these files does not include it.
__attribute__((target("avx512vbmi"), unused)) static int64_t map_bytes_vbmi(uint8_t const* values, uint8_t const* from,
                                                                            uint8_t* to, int64_t count) {
  __m512i quarters[4];
  for (int k = 0; k < 4; ++k) quarters[k] = _mm512_loadu_si512(values + 64 * k);
  int64_t i = 0;
  for (; i + 64 <= count; i += 64) {
    __m512i const x = _mm512_loadu_si512(from + i);
    __m512i const low = _mm512_permutex2var_epi8(quarters[0], x, quarters[1]);
    __m512i const high = _mm512_permutex2var_epi8(quarters[2], x, quarters[3]);
    _mm512_storeu_si512(to + i, _mm512_mask_blend_epi8(_mm512_movepi8_mask(x), low, high));
  }
  return i;
}
#endif

// A function of bytes by its 256 values, which are looked up 128 or 16 at a time.
struct ByteTable {
  alignas(64) uint8_t values[256];

  KV_HD void map(uint8_t const* from, uint8_t* to, int64_t count) const {
    int64_t i = 0;
#if defined(__AVX512BW__)
    if (__builtin_cpu_supports("avx512vbmi")) i = map_bytes_vbmi(values, from, to, count);
#endif
#if defined(__AVX2__)
    using V = Lanes<uint8_t, kByteLanes>;
    V rows[16];
    for (int k = 0; k < 16; ++k)
      for (int lane = 0; lane < kByteLanes; lane += 16) __builtin_memcpy((char*)&rows[k] + lane, values + 16 * k, 16);
    for (; i + kByteLanes <= count; i += kByteLanes) {
      V const x = load_bytes<kByteLanes>(from + i), low = x & 15;
#if defined(__AVX512BW__)
      V const high = x >> 4;
      V y{};
#pragma GCC unroll 16
      for (int k = 0; k < 16; ++k)
        y = (V)_mm512_mask_shuffle_epi8((__m512i)y, _mm512_cmpeq_epi8_mask((__m512i)high, _mm512_set1_epi8(char(k))),
                                        (__m512i)rows[k], (__m512i)low);
      store_bytes<kByteLanes>(to + i, y);
#else
      // Of two candidates a bit of x, moved to the byte's highest, takes one; of those of 16 rows its four high bits.
      __m256i y[16];
#pragma GCC unroll 16
      for (int k = 0; k < 16; ++k) y[k] = _mm256_shuffle_epi8((__m256i)rows[k], (__m256i)low);
#pragma GCC unroll 4
      for (int bit = 0; bit < 4; ++bit) {
        __m256i const takes = _mm256_slli_epi16((__m256i)x, 3 - bit);
#pragma GCC unroll 8
        for (int k = 0; k < 8 >> bit; ++k) y[k] = _mm256_blendv_epi8(y[2 * k], y[2 * k + 1], takes);
      }
      store_bytes<kByteLanes>(to + i, (V)y[0]);
#endif
    }
#endif
    for (; i < count; ++i) to[i] = values[from[i]];
  }
};

// Words below 256, as bytes.
template <int N>
KV_HD void store_low_bytes(uint8_t* p, Lanes<uint16_t, N> v) {
#if defined(__AVX2__)
  if constexpr (N == 16) {
    __m256i const packed = _mm256_packus_epi16((__m256i)v, (__m256i)v);
    return _mm_storeu_si128((__m128i*)p, _mm256_castsi256_si128(_mm256_permute4x64_epi64(packed, 8)));
  }
#endif
  store_bytes<N>(p, __builtin_convertvector(v, Lanes<uint8_t, N>));
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
    return read_lanes<N>(p);
  else
    return __builtin_bit_cast(Lanes<F, N>, load_words<N>(p));
}
template <int N, class F, class T>
KV_HD void store_as(T* p, Lanes<F, N> v) {
  if constexpr (sizeof(F) >= 4)
    store<N>(p, v);
  else if constexpr (N == 1)
    *p = T(v);
  else if constexpr (__is_same(F, T))
    write_lanes<N>(p, v);
  else
    store_low_bytes<N>(p, v);
}

}  // namespace kv
