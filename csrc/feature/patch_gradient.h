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

// Within 1e-7 (float) or 1e-15 (double): multiples of pi / 8 nearby, and the series of what is left, whose tangent is
// at most tan(pi / 16).
template <class F, int N>
KV_HD Lanes<F, N> angle_of(Lanes<F, N> y, Lanes<F, N> x) {
  using V = Lanes<F, N>;
  constexpr F half_pi = F(kPi / 2), eighth = F(0.41421356237309504880);  // tan(pi / 8)
  V const width = vabs(x), height = vabs(y), none = {};
  auto const steep = height > width;
  V const a = steep ? width : height, b = steep ? height : width;
  auto const far = a > F(0.66817863791929891999) * b, near = a <= F(0.19891236737965800691) * b;
  V const tangent = near ? none : far ? none + 1 : none + eighth;
  V const t = b == 0 ? none : (a - tangent * b) / (b + tangent * a), square = t * t;
  V series;
  if constexpr (sizeof(F) == 4) {
    constexpr F c[] = {F(1 / 9.), F(-1 / 7.), F(1 / 5.), F(-1 / 3.)};
    series = polynomial(square, c);
  } else {
    constexpr F c[] = {-1 / 23., 1 / 21., -1 / 19., 1 / 17., -1 / 15., 1 / 13.,
                       -1 / 11., 1 / 9.,  -1 / 7.,  1 / 5.,  -1 / 3.};
    series = polynomial(square, c);
  }
  V angle = t + t * square * series + (near ? none : far ? none + half_pi / 2 : none + half_pi / 4);
  angle = steep ? half_pi - angle : angle;
  angle = x < 0 ? 2 * half_pi - angle : angle;
  return y < 0 ? -angle : angle;
}

template <class F, int N>
KV_HD Polar<Lanes<F, N> > to_polar(Gradient<Lanes<F, N> > g, F eps) {
  using V = Lanes<F, N>;
  V const squared = g.x * g.x + g.y * g.y, none = {};
  V const finite = squared - squared == 0 ? squared : none;
  auto const directed = finite > 0;
  V const x = directed ? g.x : none, y = directed ? g.y : none;
  return {directed ? vsqrt(V(finite + eps)) : none, angle_of<F, N>(y, x)};
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
