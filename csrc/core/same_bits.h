// Arithmetic of doubles with the same bits on every device and instruction set. Compilers may contract a * b + c to one
// instruction where the processor has one. Formulas that must give the same bits everywhere write `fused` instead. Sums
// and products alone, divisions and square roots are rounded the same way on all devices.
#pragma once

#include "hd.h"

namespace kv {

// a b + c, rounded once.
KV_HD double fused(double a, double b, double c) {
#if defined(__CUDA_ARCH__)
  return ::fma(a, b, c);
#else
  return __builtin_fma(a, b, c);
#endif
}

// Half to even.
KV_HD double nearest(double x) {
#if defined(__CUDA_ARCH__)
  return ::rint(x);
#else
  return __builtin_rint(x);
#endif
}

// e^x within an ulp, for x in [-700, 700], to which x is clamped: e^x is out of float32's range long before.
// With x = n log(2) + r, it is 2^n times the series of e^r for |r| <= log(2) / 2, whose first missing term is below
// 1e-17.
KV_HD double exponential(double x) {
  constexpr double series[] = {
      1 / 6227020800.0, 1 / 479001600.0, 1 / 39916800.0, 1 / 3628800.0, 1 / 362880.0, 1 / 40320.0, 1 / 5040.0,
      1 / 720.0,        1 / 120.0,       1 / 24.0,       1 / 6.0,       0.5,          1.0,         1.0};
  x = clamp(x, -700., 700.);
  double const n = nearest(x * 0x1.71547652b82fep0);
  double const r = fused(-n, 0x1.abc9e3b39803fp-56, fused(-n, 0x1.62e42fefa39efp-1, x));
  double sum = series[0];
#pragma unroll
  for (int i = 1; i < 14; ++i) sum = fused(sum, r, series[i]);
  return sum * __builtin_bit_cast(double, (int64_t(n) + 1023) << 52);
}

}  // namespace kv
