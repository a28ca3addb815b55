// Variates of the standard normal distribution from words of 32 bits, by the transform of Box and Muller: one formula
// for float, on CUDA and for Lanes on the CPU, whose results differ by a few units in the last place. A pair of words
// gives two variates r cos t, r sin t.
#pragma once

#include "hd.h"
#if !defined(__CUDACC__)
#include "lanes.h"
#endif

namespace kv {

#if defined(__CUDACC__)
template <class F, int N>
using NormalLanes = F;
KV_HD float lanes_sqrt(float x) { return ::sqrtf(x); }
KV_HD float lanes_from(int32_t x) { return float(x); }
#else
template <class F, int N>
using NormalLanes = Lanes<F, N>;
template <class V>
KV_HD V lanes_sqrt(V x) {
  return vsqrt(x);
}
KV_HD float lanes_from(int32_t x) { return float(x); }
template <class I>
KV_HD auto lanes_from(I x) {
  return __builtin_convertvector(x, Lanes<float, sizeof(I) / 4>);
}
#endif

template <class V, int n>
KV_HD V horner(V x, float const (&c)[n]) {
  V sum = x * c[0] + c[1];
#pragma unroll
  for (int i = 2; i < n; ++i) sum = sum * x + c[i];
  return sum;
}

// log x of positive normal numbers: x = 2^n (1 + f) with |f| <= 1/3, and log(1 + f) = f + f^2 q(f). Exactly 0 at 1, and
// relatively as accurate near it.
template <int N>
KV_HD NormalLanes<float, N> log_of(NormalLanes<float, N> x) {
  using V = NormalLanes<float, N>;
  using I = NormalLanes<int32_t, N>;
  constexpr float q[] = {-0.1294861137866974f,  0.14004772901535034f,  -0.1216723844408989f,
                         0.14001156389713287f,  -0.16682299971580505f, 0.20010748505592346f,
                         -0.24999718368053436f, 0.3333320915699005f,   -0.5f};
  I const bits = __builtin_bit_cast(I, x), exponent = (bits - 0x3f2aaaab) & int32_t(0xff800000);
  V const f = __builtin_bit_cast(V, I(bits - exponent)) - 1, n = lanes_from(I(exponent >> 23));
  return n * 0.693147180559945f + (f + f * f * horner(f, q));
}

// Two variates. The first word, by its upper 31 bits, gives the radius; the second one the quarter and the angle
// within.
template <int N>
KV_HD void normal_pair(NormalLanes<int32_t, N> first, NormalLanes<int32_t, N> second, NormalLanes<float, N>& cosine,
                       NormalLanes<float, N>& sine) {
  using V = NormalLanes<float, N>;
  using I = NormalLanes<int32_t, N>;
  // The series of sine and cosine of pi / 2 r for |r| <= 1/2.
  constexpr float to_sine[] = {1.6044118e-4f, -4.6817541e-3f, 7.9692626e-2f, -6.4596410e-1f, 1.5707963f};
  constexpr float to_cosine[] = {9.1926027e-4f, -2.0863481e-2f, 2.5366951e-1f, -1.2337006f, 1.f};
  V const u = lanes_from(I((first >> 1) & 0x7fffffff)) * 0x1p-31f + 0x1p-32f;
  V const radius = lanes_sqrt(log_of<N>(u) * -2.f), r = lanes_from(I(second << 2)) * 0x1p-32f, square = r * r;
  V const s = r * horner(square, to_sine), c = horner(square, to_cosine);
  auto const odd = (second & 0x40000000) != 0, lower = (second & int32_t(0x80000000)) != 0;
  V const across = odd ? V(-s) : c, up = odd ? c : s;
  cosine = radius * (lower ? V(-across) : across);
  sine = radius * (lower ? V(-up) : up);
}

}  // namespace kv
