// Square root, powers of two, sine and cosine, arc tangent and rounding of doubles, of four Lanes (on the CPU), and of
// Duals of either: the functions in formulas of rotations. Scalars use the C library or CUDA, Lanes the code here with
// errors of at most 2 ulp of 1.
#pragma once

#include "dual.h"
#if !defined(__CUDACC__)
#include "any_lane.h"
#endif

namespace kv {

KV_HD double square_root(double x) { return sqrt(x); }

#if defined(__CUDACC__)

KV_HD double power_of_two(double x) { return ::exp2(x); }
KV_HD void sin_cos(double x, double& sine, double& cosine) { ::sincos(x, &sine, &cosine); }
KV_HD void sin_cos_near_zero(double x, double& sine, double& cosine) { ::sincos(x, &sine, &cosine); }
KV_HD double arctan2(double y, double x) { return ::atan2(y, x); }
KV_HD double rounded(double x) { return ::rint(x); }

#else

using Double4 = Lanes<double, 4>;

KV_HD void sin_cos(double x, double& sine, double& cosine) { sine = __builtin_sin(x), cosine = __builtin_cos(x); }
KV_HD Double4 square_root(Double4 x) { return vsqrt(x); }
KV_HD Double4 power_of_two(Double4 x) { return vexp2<double, 4>(x); }

// Half to even.
KV_HD Double4 rounded(Double4 x) {
  Double4 const shift = (x < 0 ? -0x1p52 : 0x1p52) + Double4{};
  return vabs(x) < 0x1p52 ? x + shift - shift : x;
}

// Series for |x| <= pi / 4.
KV_HD void sin_cos_series(Double4 x, Double4& sine, Double4& cosine) {
  constexpr double to_sine[] = {1 / 355687428096000.0, -1 / 1307674368000.0, 1 / 6227020800.0, -1 / 39916800.0,
                                1 / 362880.0,          -1 / 5040.0,          1 / 120.0,        -1 / 6.0};
  constexpr double to_cosine[] = {1 / 20922789888000.0, -1 / 87178291200.0, 1 / 479001600.0, -1 / 3628800.0,
                                  1 / 40320.0,          -1 / 720.0,         1 / 24.0};
  Double4 const square = x * x;
  sine = x + x * square * polynomial(square, to_sine);
  cosine = 1 - square * 0.5 + square * square * polynomial(square, to_cosine);
}

// Those of the C library, where |x| > most or x is NaN.
KV_HD void replace_far_sin_cos(Double4 x, double most, Double4& sine, Double4& cosine) {
  auto const far = !(vabs(x) <= most);
  if (any_lane(far))
    for (int i = 0; i < 4; ++i)
      if (far[i]) {
        sine[i] = __builtin_sin(x[i]);
        cosine[i] = __builtin_cos(x[i]);
      }
}

// The same for numbers that are within pi / 4 but for exceptions.
KV_HD void sin_cos_near_zero(Double4 x, Double4& sine, Double4& cosine) {
  sin_cos_series(x, sine, cosine);
  replace_far_sin_cos(x, 0.7854, sine, cosine);
}

// x = n pi / 2 + r, |r| <= pi / 4. Pi / 2 is a sum of three numbers, of which the first two have so few digits that
// their products with n are exact.
KV_HD void sin_cos(Double4 x, Double4& sine, Double4& cosine) {
  constexpr double most = 1e6, shift = 0x1.8p52;
  Double4 const shifted = x * 0.63661977236758134308 + shift, n = shifted - shift;
  Double4 const r = ((x - n * 0x1.921fb544p0) - n * 0x42d18469p-64) - n * 0x898cc51701b839p-120;
  Double4 s, c;
  sin_cos_series(r, s, c);
  auto const quarter = __builtin_bit_cast(Lanes<int64_t, 4>, shifted);
  Double4 const up = (quarter & 1) != 0 ? c : s, across = (quarter & 1) != 0 ? s : c;
  sine = (quarter & 2) != 0 ? -up : up;
  cosine = ((quarter + 1) & 2) != 0 ? -across : across;
  replace_far_sin_cos(x, most, sine, cosine);
}

// The angle of (x, y): that of multiples of pi / 8 nearby, and the series of what is left, whose tangent is at most
// tan(pi / 16).
KV_HD Double4 arctan2(Double4 y, Double4 x) {
  constexpr double series[] = {-1 / 23.0, 1 / 21.0, -1 / 19.0, 1 / 17.0, -1 / 15.0, 1 / 13.0,
                               -1 / 11.0, 1 / 9.0,  -1 / 7.0,  1 / 5.0,  -1 / 3.0};
  constexpr double pi = 3.14159265358979323846, eighth = 0.41421356237309504880;  // tan(pi / 8)
  Double4 const width = vabs(x), height = vabs(y), none = {};
  auto const steep = height > width;
  Double4 const a = steep ? width : height, b = steep ? height : width;
  auto const far = a > 0.66817863791929891999 * b,
             near = a <= 0.19891236737965800691 * b;  // tan(3 pi / 16), tan(pi / 16)
  Double4 const tangent = near ? none : far ? none + 1 : none + eighth;
  Double4 const t = b == 0 ? none : (a - tangent * b) / (b + tangent * a), square = t * t;
  Double4 angle = t + t * square * polynomial(square, series) + (near ? none : far ? none + pi / 4 : none + pi / 8);
  angle = steep ? pi / 2 - angle : angle;
  angle = x < 0 ? pi - angle : angle;
  using Bits = Lanes<uint64_t, 4>;
  Bits const sign = __builtin_bit_cast(Bits, y) & (uint64_t(1) << 63);
  return __builtin_bit_cast(Double4, Bits(__builtin_bit_cast(Bits, angle) | sign));
}

#endif

template <class V, int N>
KV_HD Dual<V, N> square_root(Dual<V, N> a) {
  a.value = square_root(a.value);
  V const derivative = 0.5 / a.value;
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * derivative;
  return a;
}
template <class V, int N>
KV_HD Dual<V, N> power_of_two(Dual<V, N> a) {
  a.value = power_of_two(a.value);
  V const derivative = a.value * 0.69314718055994530942;
  for (int i = 0; i < N; ++i) a.d[i] = a.d[i] * derivative;
  return a;
}
template <class V, int N>
KV_HD void set_derivatives(Dual<V, N> const& a, Dual<V, N>& sine, Dual<V, N>& cosine) {
  for (int i = 0; i < N; ++i) {
    sine.d[i] = cosine.value * a.d[i];
    cosine.d[i] = -sine.value * a.d[i];
  }
}
template <class V, int N>
KV_HD void sin_cos(Dual<V, N> const& a, Dual<V, N>& sine, Dual<V, N>& cosine) {
  sin_cos(a.value, sine.value, cosine.value);
  set_derivatives(a, sine, cosine);
}
template <class V, int N>
KV_HD void sin_cos_near_zero(Dual<V, N> const& a, Dual<V, N>& sine, Dual<V, N>& cosine) {
  sin_cos_near_zero(a.value, sine.value, cosine.value);
  set_derivatives(a, sine, cosine);
}
template <class V, int N>
KV_HD Dual<V, N> arctan2(Dual<V, N> const& y, Dual<V, N> const& x) {
  Dual<V, N> angle;
  angle.value = arctan2(y.value, x.value);
  V const square = x.value * x.value + y.value * y.value, along_y = x.value / square, along_x = -y.value / square;
  for (int i = 0; i < N; ++i) angle.d[i] = along_y * y.d[i] + along_x * x.d[i];
  return angle;
}
// As a plain value: its derivative is 0.
template <class V, int N>
KV_HD V rounded(Dual<V, N> const& a) {
  return rounded(a.value);
}

}  // namespace kv
