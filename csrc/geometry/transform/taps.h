// The taps of a coordinate along an axis: which pixels, their weights and the derivatives of these; sampling.h has the
// rules. Included by kernels. V is F or lanes of it, I int or lanes of it.
#pragma once

#include "core/cubic.h"
#include "geometry/transform/sampling.h"
#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif

namespace kv::geometry {

#if defined(__CUDACC__)
#define KV_TAPS __device__ __forceinline__
KV_TAPS float vfloor(float x) { return ::floorf(x); }
KV_TAPS double vfloor(double x) { return ::floor(x); }
// The nearest number above or between them; low for NaN.
KV_TAPS float vabove(float x, float low) { return ::fmaxf(x, low); }
KV_TAPS double vabove(double x, double low) { return ::fmax(x, low); }
// A number of at most 1, or 0 where it is less or NaN.
KV_TAPS float vsaturate(float x) { return __saturatef(x); }
KV_TAPS double vsaturate(double x) { return ::fmax(x, 0.); }
KV_TAPS float vclamp(float x, float low, float high) { return ::fminf(::fmaxf(x, low), high); }
KV_TAPS double vclamp(double x, double low, double high) { return ::fmin(::fmax(x, low), high); }
KV_TAPS float vabs(float x) { return ::fabsf(x); }
KV_TAPS double vabs(double x) { return ::fabs(x); }
template <class F>
KV_TAPS int floor_to_int(float x) {
  return __float2int_rd(x);
}
template <class F>
KV_TAPS int floor_to_int(double x) {
  return __double2int_rd(x);
}
template <class F>
KV_TAPS F to_float(int i) {
  return F(i);
}
#else
#define KV_TAPS KV_HD
template <class V>
KV_HD V vabove(V x, V low) {
  return max(low, x);
}
template <class V>
KV_HD V vclamp(V x, V low, V high) {
  return min(high, max(low, x));
}
template <class F, class I>
KV_HD auto to_float(I i) {
  if constexpr (sizeof(I) == sizeof(int))
    return F(i);
  else
    return __builtin_convertvector(i, Lanes<F, sizeof(I) / sizeof(int)>);
}
template <class F, class V>
KV_HD auto floor_to_int(V x) {
  if constexpr (sizeof(V) == sizeof(F)) {
    int const i = int(x);
    return i - (F(i) > x);
  } else {
    using I = Lanes<int, sizeof(V) / sizeof(F)>;
    I const i = __builtin_convertvector(x, I);  // towards 0
    return I(i + __builtin_convertvector(to_float<F>(i) > x, I));
  }
}
#endif

// --- coordinates and pixels ------------------------------------------------------------------------------------------

// A coordinate of the same value that is near the image, so that its taps fit ints: for the fill and the border, where
// NaN is out of bounds to the left, and for the reflection.
template <class F, class V>
KV_TAPS V clamped(Axis<F> const& axis, V x) {
  V const zero{};
  return vclamp(x, V(zero - 4), V(zero + F(axis.size + 3)));
}
template <class F, class V>
KV_TAPS V reflected(Axis<F> const& axis, V x) {
  V const zero{};
  F const period = F(2 * (axis.align_corners ? axis.size - 1 : axis.size));
  if (period == 0) return zero;
  x = x - period * vfloor(V(x / period));
  return vclamp(x, zero, V(zero + period));
}
template <class F, class V>
KV_TAPS V near_image(Axis<F> const& axis, V x) {
  return axis.padding == Padding::reflection ? reflected(axis, x) : clamped(axis, x);
}

// The pixel of tap i, or i itself where it is out of bounds and reads the fill.
template <class F, class I>
KV_TAPS I pixel_at(Axis<F> const& axis, I i) {
  if (axis.padding == Padding::fill) return i;
  I const zero{}, last = zero + (axis.size - 1);
  if (axis.padding == Padding::reflection) {
    int const edge = axis.align_corners ? 0 : 1;
    i = i < 0 ? I(-i - edge) : i;
    i = i > last ? I(2 * (axis.size - 1) + edge - i) : i;
    i = i < 0 ? I(-i - edge) : i;
  }
  return min(last, max(zero, i));
}

// --- weights ---------------------------------------------------------------------------------------------------------

constexpr float kCubic = -0.75f;  // of Keys' cubic, as OpenCV and torch have it

// The coordinate of which the nearest pixel is read, in multiples of 2^-12 (double: 2^-30; larger ones beyond 1024
// pixels): resized crops have whole rows midway between two pixels but for errors of rounding, which differ between
// processors.
template <class F, class V>
KV_TAPS V snapped(V x) {
  constexpr F shift = sizeof(F) == 4 ? F(0x1.8p11) : F(0x1.8p22);
  return (x + shift) - shift;
}

// The first of K taps, and the fraction of x, which is near the image.
template <int K, class F, class V>
KV_TAPS auto first_tap(V x, V& t) {
  if constexpr (K == 1) {
    constexpr F shift = sizeof(F) == 4 ? F(0x1.8p23) : F(0x1.8p52);  // rounds a number less than a quarter of it
    t = V{};
    return floor_to_int<F>(V((snapped<F>(x) + shift) - shift));
  } else {
    auto const whole = floor_to_int<F>(x);
    t = x - to_float<F>(whole);
    return K == 4 ? whole - 1 : whole;
  }
}

template <int K, class V>
KV_TAPS void tap_weights(V t, V (&w)[K]) {
  V const one = V{} + 1;
  if constexpr (K == 1) {
    w[0] = one;
  } else if constexpr (K == 2) {
    w[0] = one - t;
    w[1] = t;
  } else {
    V const s = one - t;
    w[0] = cubic_outer(kCubic, t, s);
    w[1] = cubic_inner(kCubic, t);
    w[2] = cubic_inner(kCubic, s);
    w[3] = cubic_outer(kCubic, s, t);
  }
}

// The derivatives of these weights.
template <int K, class V>
KV_TAPS void tap_derivatives(V t, V (&d)[K]) {
  V const one = V{} + 1;
  if constexpr (K == 1) {
    d[0] = V{};
  } else if constexpr (K == 2) {
    d[0] = -one;
    d[1] = one;
  } else {
    V const s = one - t;
    d[0] = cubic_outer_derivative(kCubic, t, s);
    d[1] = cubic_inner_derivative(kCubic, t);
    d[2] = -cubic_inner_derivative(kCubic, s);
    d[3] = -cubic_outer_derivative(kCubic, s, t);
  }
}

#if defined(__CUDACC__)
// The weight of one pixel at a coordinate, equal to that of tap_weights; 0 where it is no tap of the coordinate.
template <int K, class F>
KV_TAPS F weight_at(F coord, int pixel) {
  if constexpr (K == 1) {
    F t;
    return first_tap<1, F>(vclamp(coord, F(pixel - 1), F(pixel + 1)), t) == pixel;
  } else {
    F const distance = vabs(coord - F(pixel));
    if constexpr (K == 2) return vsaturate(1 - distance);
    F const s = 2 - distance;
    F const inner = cubic_inner(kCubic, distance), outer = cubic_outer(kCubic, distance - 1, s);
    return distance < 1 ? inner : s > 0 ? outer : 0;
  }
}
#endif

#undef KV_TAPS

}  // namespace kv::geometry
