// SIMD values. Included by *_cpu.cpp files, which are compiled once per instruction set.
//
// Lanes<F, N> is the compiler's vector of N numbers, and F itself for N = 1, so a formula templated on its value type
// serves the interior of a row (N = kLanes) and its tail and borders (N = 1). Operators (+, *, <, ?:) are those of the
// language.
#pragma once

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include <utility>

#include "half.h"

namespace kv {

#if defined(__AVX512F__)
constexpr int kVectorBytes = 64;
#elif defined(__AVX2__)
constexpr int kVectorBytes = 32;
#else
constexpr int kVectorBytes = 16;
#endif

template <class F, int N>
struct lanes_of {
  typedef F type __attribute__((vector_size(N * sizeof(F))));
};
template <class F>
struct lanes_of<F, 1> {
  using type = F;
};
template <class F, int N>
using Lanes = typename lanes_of<F, N>::type;

// How many pixels stored as T one vector computes.
template <class T>
constexpr int kLanes = kVectorBytes / int(sizeof(Compute<T>));

template <int N, class F>
KV_HD Lanes<F, N> broadcast(F x) {
  if constexpr (N == 1)
    return x;
  else
    return x - Lanes<F, N>{};
}

// --- as they are in memory -------------------------------------------------------------------------------------------

// Vectors are aligned to their size, numbers in memory to their own: all of memory is read and written through this.
template <class V>
struct [[gnu::packed, gnu::may_alias]] InMemory {
  V lanes;
};
template <int N, class F>
KV_HD Lanes<F, N> read_lanes(F const* p) {
  if constexpr (N == 1)
    return *p;
  else
    return reinterpret_cast<InMemory<Lanes<F, N>> const*>(p)->lanes;
}
template <int N, class F>
KV_HD void write_lanes(F* p, Lanes<F, N> v) {
  if constexpr (N == 1)
    *p = v;
  else
    reinterpret_cast<InMemory<Lanes<F, N>>*>(p)->lanes = v;
}

// --- memory -> lanes -------------------------------------------------------------------------------------------------

template <int N>
KV_HD Lanes<float, N> load(float const* p) {
  return read_lanes<N>(p);
}
template <int N>
KV_HD Lanes<double, N> load(double const* p) {
  return read_lanes<N>(p);
}
template <int N>
KV_HD Lanes<float, N> load(uint8_t const* p) {
  if constexpr (N == 1) {
    return float(*p);
  } else {
#if defined(__AVX512F__)
    if constexpr (N == 16)
      return (Lanes<float, N>)_mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((__m128i const*)p)));
#elif defined(__AVX2__)
    if constexpr (N == 8)
      return (Lanes<float, N>)_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((__m128i const*)p)));
#endif
    // Through 16 bits: GCC takes a wider step byte by byte.
    auto const half = __builtin_convertvector(read_lanes<N>(p), Lanes<uint16_t, N>);
    return __builtin_convertvector(__builtin_convertvector(half, Lanes<int32_t, N>), Lanes<float, N>);
  }
}
template <int N>
KV_HD Lanes<float, N> load(BFloat16 const* p) {
  if constexpr (N == 1)
    return to_float(*p);
  else
    return (Lanes<float, N>)(__builtin_convertvector(read_lanes<N>(&p->bits), Lanes<uint32_t, N>) << 16);
}
template <int N>
KV_HD Lanes<float, N> load(Half const* p) {
  if constexpr (N == 1) {
#if defined(__F16C__)
    return _cvtsh_ss(p->bits);
#else
    return to_float(*p);
#endif
  } else {
#if defined(__F16C__)
    if constexpr (N == 8) return (Lanes<float, N>)_mm256_cvtph_ps(_mm_loadu_si128((__m128i const*)p));
    if constexpr (N == 4) return (Lanes<float, N>)_mm_cvtph_ps(_mm_loadl_epi64((__m128i const*)p));
#endif
#if defined(__AVX512F__)
    if constexpr (N == 16) return (Lanes<float, N>)_mm512_cvtph_ps(_mm256_loadu_si256((__m256i const*)p));
#endif
    Lanes<float, N> v;
    for (int i = 0; i < N; ++i) v[i] = to_float(p[i]);
    return v;
  }
}

// --- lanes -> memory -------------------------------------------------------------------------------------------------

template <int N>
KV_HD void store(float* p, Lanes<float, N> v) {
  write_lanes<N>(p, v);
}
template <int N>
KV_HD void store(double* p, Lanes<double, N> v) {
  write_lanes<N>(p, v);
}
// Bytes saturate and round half to even, as OpenCV does; NaN becomes 0.
template <int N>
KV_HD void store(uint8_t* p, Lanes<float, N> v) {
  // Special case: of one and two vectors what the language has no operators for. Numbers above 2^31 convert to it.
#if defined(__AVX512F__)
  if constexpr (N == 16) {
    __m512 const positive = _mm512_max_ps((__m512)v, _mm512_setzero_ps());  // of NaN the second operand
    return _mm_storeu_si128((__m128i*)p, _mm512_cvtusepi32_epi8(_mm512_cvtps_epi32(positive)));
  }
#elif defined(__AVX2__)
  if constexpr (N == 8) {
    __m256 const clamped = _mm256_min_ps(_mm256_max_ps((__m256)v, _mm256_setzero_ps()), _mm256_set1_ps(255));
    __m256i const ints = _mm256_cvtps_epi32(clamped);
    __m128i const words = _mm_packs_epi32(_mm256_castsi256_si128(ints), _mm256_extracti128_si256(ints, 1));
    return _mm_storel_epi64((__m128i*)p, _mm_packus_epi16(words, words));
  }
#endif
  v = v > 0.f ? v : v * 0.f;
  v = v > 0.f ? v : broadcast<N>(0.f);  // NaN * 0 is NaN
  v = v < 255.f ? v : broadcast<N>(255.f);
  v = v + 0x1.8p23f;  // the integer part moves to the low bits of the mantissa
  if constexpr (N == 1)
    *p = uint8_t(float_to_bits(v));
  else
    write_lanes<N>(p, __builtin_convertvector(__builtin_convertvector((Lanes<int32_t, N>)v & 0xff, Lanes<uint16_t, N>),
                                              Lanes<uint8_t, N>));
}
template <int N>
KV_HD void store(BFloat16* p, Lanes<float, N> v) {
  if constexpr (N == 1) {
    *p = to_bfloat16(v);
  } else {
    auto const bits = (Lanes<uint32_t, N>)v;
    auto const rounded = (bits + 0x7fff + ((bits >> 16) & 1)) >> 16;
    auto const kept = v == v ? rounded : Lanes<uint32_t, N>{} + 0x7fc0;
    write_lanes<N>(&p->bits, __builtin_convertvector(kept, Lanes<uint16_t, N>));
  }
}
template <int N>
KV_HD void store(Half* p, Lanes<float, N> v) {
  if constexpr (N == 1) {
#if defined(__F16C__)
    p->bits = _cvtss_sh(v, _MM_FROUND_TO_NEAREST_INT);
#else
    *p = to_half(v);
#endif
  } else {
#if defined(__F16C__)
    if constexpr (N == 8) return _mm_storeu_si128((__m128i*)p, _mm256_cvtps_ph((__m256)v, _MM_FROUND_TO_NEAREST_INT));
    if constexpr (N == 4) return _mm_storel_epi64((__m128i*)p, _mm_cvtps_ph((__m128)v, _MM_FROUND_TO_NEAREST_INT));
#endif
#if defined(__AVX512F__)
    if constexpr (N == 16) {
      _mm256_storeu_si256((__m256i*)p, _mm512_cvtps_ph((__m512)v, _MM_FROUND_TO_NEAREST_INT));
      return;
    }
#endif
    for (int i = 0; i < N; ++i) p[i] = to_half(v[i]);
  }
}

// --- permutations ----------------------------------------------------------------------------------------------------

// Lanes first, first + 2, ... of a and b, counted through both.
template <int first, class V, int... i>
KV_HD V every_second(V a, V b, std::integer_sequence<int, i...>) {
  return __builtin_shufflevector(a, b, (first + 2 * i)...);
}
template <int first, class V>
KV_HD V every_second(V a, V b) {
  return every_second<first>(a, b, std::make_integer_sequence<int, sizeof(V) / sizeof(a[0])>());
}

// Lane i of the result is lane index[i] of a, or of a and b, counted through both. Clang has no __builtin_shuffle.
template <int N, class V, class Index>
KV_HD V permuted(V a, Index index) {
  if constexpr (N == 1) {
    return a;
  } else {
#if !defined(__clang__)
    return __builtin_shuffle(a, index);
#else
#if defined(__AVX512F__)
    if constexpr (sizeof(V) == 64 && N == 16) return (V)_mm512_permutexvar_ps((__m512i)index, (__m512)a);
#elif defined(__AVX2__)
    if constexpr (sizeof(V) == 32 && N == 8) return (V)_mm256_permutevar8x32_ps((__m256)a, (__m256i)index);
#endif
    V result;
    for (int i = 0; i < N; ++i) result[i] = a[index[i]];
    return result;
#endif
  }
}
template <int N, class V, class Index>
KV_HD V permuted(V a, V b, Index index) {
  if constexpr (N == 1) {
    return a;
  } else {
#if !defined(__clang__)
    return __builtin_shuffle(a, b, index);
#else
#if defined(__AVX512F__)
    if constexpr (sizeof(V) == 64 && N == 16) return (V)_mm512_permutex2var_ps((__m512)a, (__m512i)index, (__m512)b);
#endif
    return index < N ? permuted<N>(a, index & (N - 1)) : permuted<N>(b, index & (N - 1));
#endif
  }
}

// --- what the language has no operator for ---------------------------------------------------------------------------

// min, max and clamp of hd.h work on lanes as they are. A NaN operand gives the other one or itself, as minps does.
// For AVX-512 GCC makes two instructions of that, so there min and max are spelt out.
#if defined(__AVX512F__)
KV_HD Lanes<float, 16> min(Lanes<float, 16> a, Lanes<float, 16> b) {
  return (Lanes<float, 16>)_mm512_min_ps((__m512)b, (__m512)a);
}
KV_HD Lanes<float, 16> max(Lanes<float, 16> a, Lanes<float, 16> b) {
  return (Lanes<float, 16>)_mm512_max_ps((__m512)b, (__m512)a);
}
KV_HD Lanes<double, 8> min(Lanes<double, 8> a, Lanes<double, 8> b) {
  return (Lanes<double, 8>)_mm512_min_pd((__m512d)b, (__m512d)a);
}
KV_HD Lanes<double, 8> max(Lanes<double, 8> a, Lanes<double, 8> b) {
  return (Lanes<double, 8>)_mm512_max_pd((__m512d)b, (__m512d)a);
}
#endif

template <class V>
KV_HD V vsqrt(V v) {
  if constexpr (__is_same(V, float) || __is_same(V, double)) {
    return sqrt(v);
  } else {
#if defined(__AVX512F__)
    if constexpr (__is_same(V, Lanes<float, 16>)) return (V)_mm512_sqrt_ps((__m512)v);
    if constexpr (__is_same(V, Lanes<double, 8>)) return (V)_mm512_sqrt_pd((__m512d)v);
#elif defined(__AVX2__)
    if constexpr (__is_same(V, Lanes<float, 8>)) return (V)_mm256_sqrt_ps((__m256)v);
    if constexpr (__is_same(V, Lanes<double, 4>)) return (V)_mm256_sqrt_pd((__m256d)v);
#endif
    for (int i = 0; i < int(sizeof(V) / sizeof(v[0])); ++i) v[i] = sqrt(v[i]);
    return v;
  }
}

template <class V>
KV_HD V vabs(V v) {
  if constexpr (__is_same(V, float))
    return __builtin_fabsf(v);
  else if constexpr (__is_same(V, double))
    return __builtin_fabs(v);
  else if constexpr (sizeof(v[0]) == 4)
    return __builtin_bit_cast(V, __builtin_bit_cast(Lanes<uint32_t, sizeof(V) / 4>, v) & 0x7fffffffu);
  else
    return __builtin_bit_cast(V, __builtin_bit_cast(Lanes<uint64_t, sizeof(V) / 8>, v) & 0x7fffffffffffffffu);
}

// c[0] x^(n-1) + ... + c[n-1]
template <class V, class F, int n>
KV_HD V polynomial(V x, F const (&c)[n]) {
  V sum = x * c[0] + c[1];
  for (int i = 2; i < n; ++i) sum = sum * x + c[i];
  return sum;
}

// 2^x within 2 units in the last place: 2^n p(x - n) with n the nearest integer, and p(f) = 2^f on [-1/2, 1/2] within
// 3e-9 (float) or 2e-17 (double), p(0) = 1. Below the normal numbers it is 0, from 2^127.5 (2^1023.5) on inf; NaN
// stays.
template <class F, int N>
KV_HD Lanes<F, N> vexp2(Lanes<F, N> x) {
  using V = Lanes<F, N>;
  // Adding `shift` rounds x and leaves n + bias in the low bits, from where they move to the exponent.
  if constexpr (sizeof(F) == 4) {
    constexpr float bias = 127, shift = 0x1.8p23f + bias;
    constexpr float c[] = {
        1.55946874e-4f, 1.34066444e-3f, 9.61769296e-3f, 5.55031055e-2f, 2.40226528e-1f, 6.93147215e-1f, 1.f};
    x = min(max(x, broadcast<N>(-bias)), broadcast<N>(bias + 1));
    V const shifted = x + shift;
    auto const exponent = __builtin_bit_cast(Lanes<int32_t, N>, shifted) << 23;
    return polynomial(V(x - (shifted - shift)), c) * __builtin_bit_cast(V, exponent);
  } else {
    constexpr double bias = 1023, shift = 0x1.8p52 + bias;
    constexpr double c[] = {4.0779938562463538e-10, 7.0725704454692941e-9, 1.0180648196555812e-7, 1.3215442675115585e-6,
                            1.5252727383872463e-5,  1.5403530441572599e-4, 1.3333558153441335e-3, 9.6181291076070020e-3,
                            5.5504108664790389e-2,  2.4022650695910098e-1, 6.9314718055994570e-1, 1.};
    x = min(max(x, broadcast<N>(-bias)), broadcast<N>(bias + 1));
    V const shifted = x + shift;
    auto const exponent = __builtin_bit_cast(Lanes<int64_t, N>, shifted) << 52;
    return polynomial(V(x - (shifted - shift)), c) * __builtin_bit_cast(V, exponent);
  }
}

template <int bytes>
struct integer_of {
  using type = int64_t;
  using bits = uint64_t;
};
template <>
struct integer_of<4> {
  using type = int32_t;
  using bits = uint32_t;
};

// log2 x of normal numbers, within 2 units in the last place or 1e-7 (1e-16) near 1: x = 2^n m with m in [sqrt(1/2),
// sqrt(2)), and log2 m = 2 / ln 2 artanh((m - 1) / (m + 1)) by its series. NaN and inf stay; of other numbers the
// result is some finite one.
template <class F, int N>
KV_HD Lanes<F, N> vlog2(Lanes<F, N> x) {
  using V = Lanes<F, N>;
  constexpr bool kFloat = sizeof(F) == 4;
  using I = typename integer_of<sizeof(F)>::type;
  using Bits = Lanes<I, N>;
  constexpr int mantissa = kFloat ? 23 : 52;
  constexpr I bias = kFloat ? 127 : 1023, one = bias << mantissa, root = kFloat ? I(0x3f3504f3) : I(0x3fe6a09e667f3bcd);
  using Unsigned = typename integer_of<sizeof(F)>::bits;
  auto const shifted = __builtin_bit_cast(Lanes<Unsigned, N>, x) + Unsigned(one - root);  // of NaN it wraps around
  Bits const bits = __builtin_bit_cast(Bits, shifted);
  Bits const exponent = (bits >> mantissa) - bias;
  V const m = __builtin_bit_cast(V, Bits((bits & ((I(1) << mantissa) - 1)) + root));
  V const t = (m - 1) / (m + 1), square = t * t;
  constexpr F k = F(2.88539008177792681472);
  V series;
  if constexpr (kFloat) {
    constexpr float c[] = {k / 9, k / 7, k / 5, k / 3, k};
    series = polynomial(square, c);
  } else {
    constexpr double c[] = {k / 21, k / 19, k / 17, k / 15, k / 13, k / 11, k / 9, k / 7, k / 5, k / 3, k};
    series = polynomial(square, c);
  }
  V n;
  if constexpr (N == 1)
    n = F(exponent);
  else
    n = __builtin_convertvector(exponent, V);
  V const y = t * series + n;
  return x - x == 0 ? y : x;
}

template <class V>
KV_HD V vfloor(V v) {
  if constexpr (__is_same(V, float)) {
    return __builtin_floorf(v);
  } else if constexpr (__is_same(V, double)) {
    return __builtin_floor(v);
  } else {
#if defined(__AVX512F__)
    if constexpr (__is_same(V, Lanes<float, 16>)) return (V)_mm512_floor_ps((__m512)v);
    if constexpr (__is_same(V, Lanes<double, 8>)) return (V)_mm512_floor_pd((__m512d)v);
#elif defined(__AVX2__)
    if constexpr (__is_same(V, Lanes<float, 8>)) return (V)_mm256_floor_ps((__m256)v);
    if constexpr (__is_same(V, Lanes<double, 4>)) return (V)_mm256_floor_pd((__m256d)v);
#endif
    for (int i = 0; i < int(sizeof(V) / sizeof(v[0])); ++i) v[i] = vfloor(v[i]);
    return v;
  }
}

// Calls f(index constant N, element) over [begin, end): vectors of N, by default kLanes<T>, the last one overlapping
// the one before it (so f must not read what it writes), and single elements where the range is shorter than a vector.
template <int N>
struct Width {
  static constexpr int value = N;
};
template <class T, int N = kLanes<T>, class F>
KV_HD void for_each_vector(int64_t begin, int64_t end, F f) {
  if (end - begin < N) {
    for (int64_t e = begin; e < end; ++e) f(Width<1>{}, e);
    return;
  }
  int64_t e = begin;
  for (; e + N <= end; e += N) f(Width<N>{}, e);
  if (e < end) f(Width<N>{}, end - N);
}

}  // namespace kv
