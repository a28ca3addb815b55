// Gradients of square patches with a repeated border, as magnitude and angle, and their transpose. Included by the
// operators of patches.
//
//          -s 0 s            -s -m -s
//   gx  =  -m 0 m      gy  =  0  0  0      s = 0, m = 1/2: central differences; s = 1/8, m = 1/4: Sobel
//          -s 0 s             s  m  s
#pragma once

#include "core/hd.h"
#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif

namespace kv::feature {

// Sides of patches whose kernels on CUDA have all their arrays in shared memory.
constexpr int kLargestSharedPatch = 88;

template <class F>
struct Stencil {
  F side, middle;
};
template <class F>
KV_HD Stencil<F> central_differences() {
  return {0, F(0.5)};
}
template <class F>
KV_HD Stencil<F> sobel_stencil() {
  return {F(0.125), F(0.25)};
}

template <class V>
struct Gradient {
  V x, y;
};

// at(dy, dx) reads the neighbors of a pixel.
template <class F, class At>
KV_HD auto patch_gradient(Stencil<F> s, At at) {
  auto const x = (at(0, 1) - at(0, -1)) * s.middle, y = (at(1, 0) - at(-1, 0)) * s.middle;
  if (s.side == 0) return Gradient<decltype(+x)>{x, y};
  return Gradient<decltype(+x)>{x + (at(-1, 1) - at(-1, -1) + at(1, 1) - at(1, -1)) * s.side,
                                y + (at(1, -1) - at(-1, -1) + at(1, 1) - at(-1, 1)) * s.side};
}

// The gradient of a pixel from u = dL/dgx and v = dL/dgy of its neighbors. Out of bounds u has the value of the border
// pixel, with its sign changed along x, and v with its sign changed along y: so the transpose of the border is.
template <class F, class U, class V>
KV_HD auto patch_gradient_vjp(Stencil<F> s, U u, V v) {
  auto const sum = (u(0, -1) - u(0, 1) + v(-1, 0) - v(1, 0)) * s.middle;
  if (s.side == 0) return sum;
  return sum + (u(-1, -1) - u(-1, 1) + u(1, -1) - u(1, 1) + v(-1, -1) - v(1, -1) + v(-1, 1) - v(1, 1)) * s.side;
}

// sqrt(gx^2 + gy^2 + eps) and the angle from x to y in [-pi, pi]. A gradient that is zero or not finite has no
// direction and contributes nothing: both are 0, and so is their derivative.
template <class V>
struct Polar {
  V magnitude, angle;
};

constexpr double kPi = 3.14159265358979323846;

#if defined(__CUDACC__)

__device__ __forceinline__ float angle_of(float y, float x) { return ::atan2f(y, x); }
__device__ __forceinline__ double angle_of(double y, double x) { return ::atan2(y, x); }

template <class F>
__device__ __forceinline__ bool has_direction(F squared) {
  return squared > 0 && squared - squared == 0;
}
template <class F>
__device__ __forceinline__ Polar<F> to_polar(Gradient<F> g, F eps) {
  F const squared = g.x * g.x + g.y * g.y;
  if (!has_direction(squared)) return {0, 0};
  return {::sqrt(squared + eps), angle_of(g.y, g.x)};
}

#else

KV_HD bool has_direction(float squared) { return squared > 0 && squared - squared == 0; }
KV_HD bool has_direction(double squared) { return squared > 0 && squared - squared == 0; }

// v, negated where s is negative.
template <class F, int N>
KV_HD Lanes<F, N> negated_by(Lanes<F, N> s, Lanes<F, N> v) {
  using Bits = Lanes<typename integer_of<sizeof(F)>::bits, N>;
  Bits const sign = __builtin_bit_cast(Bits, s) & (typename integer_of<sizeof(F)>::bits(1) << (8 * sizeof(F) - 1));
  return __builtin_bit_cast(Lanes<F, N>, Bits(__builtin_bit_cast(Bits, v) ^ sign));
}

// Within 4e-7 (float) or 1e-15 (double): that of the first octant by a minimax polynomial of (atan(t) / t - 1) / t^2,
// turned. Gradients of 0 and those that are not finite give any number or NaN.
template <class F, int N>
KV_HD Lanes<F, N> angle_of(Lanes<F, N> y, Lanes<F, N> x) {
  using V = Lanes<F, N>;
  constexpr F half_pi = F(kPi / 2);
  V const width = vabs(x), height = vabs(y), none = {};
  V const t = min(width, height) / max(width, height), square = t * t;
  V series;
  if constexpr (sizeof(F) == 4) {
    constexpr F c[] = {-4.3553850e-3f, 2.3040064e-2f,  -5.7773492e-2f, 9.7942278e-2f,
                       -1.3976580e-1f, 1.99627035e-1f, -3.33316590e-1f};
    series = polynomial(square, c);
  } else {
    constexpr F c[] = {-1.7656321234343396e-5, 1.9779598863425907e-4, -1.0512689753441275e-3, 3.5474150742443884e-3,
                       -8.6072302164316396e-3, 1.6195344293177326e-2, -2.5032258784772563e-2, 3.3452314129914370e-2,
                       -4.0558940413868386e-2, 4.6569953564046746e-2, -5.2332047456763639e-2, 5.8756706554030951e-2,
                       -6.6655259746695615e-2, 7.6921627584538851e-2, -9.0908958954595872e-2, 1.1111110296188281e-1,
                       -1.4285714254355201e-1, 1.9999999999351877e-1, -3.3333333333328197e-1};
    series = polynomial(square, c);
  }
  auto const steep = height > width;
  V const first = steep ? none + half_pi : x < 0 ? none + 2 * half_pi : none, turn = steep ? none - 1 : none + 1;
  V const sign = negated_by<F, N>(y, negated_by<F, N>(x, turn));
  return negated_by<F, N>(y, first) + sign * (t + t * square * series);
}

template <class F, int N>
KV_HD Polar<Lanes<F, N> > to_polar(Gradient<Lanes<F, N> > g, F eps) {
  using V = Lanes<F, N>;
  V const squared = g.x * g.x + g.y * g.y, none = {};
  auto const directed = squared * 0 < squared;  // 0 times infinity is NaN
  return {directed ? vsqrt(V(squared + eps)) : none, directed ? angle_of<F, N>(g.y, g.x) : none};
}

#endif

// From the gradients to magnitude and angle that to_polar(g, eps) returned.
template <class F>
KV_HD Gradient<F> to_polar_vjp(Gradient<F> g, F magnitude, F grad_magnitude, F grad_angle) {
  F const squared = g.x * g.x + g.y * g.y;
  if (!has_direction(squared)) return {0, 0};
  F const along = grad_magnitude / magnitude, across = grad_angle / squared;
  return {along * g.x - across * g.y, along * g.y + across * g.x};
}

// The two bins of an angle around the circle, of which bin `offset` is centered on angle 0, and the weight of the
// second.
template <class F>
struct AngularVote {
  int first, second;
  F t;
};
template <class F>
KV_HD AngularVote<F> angular_vote(F angle, int bins, F offset) {
  F position = angle * (F(bins) / F(2 * kPi)) + offset;
  position = position < 0 ? position + F(bins) : position;
  int const whole = int(position), first = whole >= bins ? whole - bins : whole;
  return {first, first + 1 == bins ? 0 : first + 1, position - F(whole)};
}

// A Gaussian around the center of n pixels, not normalized.
template <class F>
KV_HD F centered_gaussian(int i, int n, F sigma) {
  F const x = (F(i) - F(n - 1) / 2) / sigma;
#if defined(__CUDACC__)
  return F(::exp(-x * x / 2));
#else
  return F(__builtin_exp(double(-x * x / 2)));
#endif
}

}  // namespace kv::feature
