// Fundamental matrices of seven correspondences: up to three of rank 2, NaN for missing ones. No step branches, so V is
// a number or Lanes, one sample in each.
//
//   n = (p - m) / s        points normalized by their mean and their mean distance |x| + |y| from it
//   D, F                   an orthonormal basis of the null space of seven rows n2 n1^T: the last columns of Q, for
//                          Householder's reflections that make the transpose of the rows triangular
//   det(a D + F) = 0       a cubic, whose outermost root Newton's method approaches from outside
#pragma once

#include "core/matrix3.h"

namespace kv::geometry::seven_points {

template <class V>
KV_HD V root(V x) {
  if constexpr (__is_same(V, double))
    return sqrt(x);
  else
    return vsqrt(x);  // of core/lanes.h
}
template <class V>
KV_HD V magnitude(V x) {
  return x < 0 ? V(-x) : x;
}

template <class V>
struct Normalized {
  V points[7][2], mean[2], scale;

  KV_HD explicit Normalized(V const (&p)[7][2]) {
    V distance{};
    for (int k = 0; k < 2; ++k) {
      mean[k] = V{};
      for (int i = 0; i < 7; ++i) mean[k] += p[i][k];
      mean[k] = mean[k] * (1.0 / 7);
      for (int i = 0; i < 7; ++i) points[i][k] = p[i][k] - mean[k], distance += magnitude(points[i][k]);
    }
    scale = 7.0 / distance;
    for (int i = 0; i < 7; ++i)
      for (int k = 0; k < 2; ++k) points[i][k] *= scale;
  }
  // m T for the rows of m, T the matrix of the map to normalized points.
  KV_HD void multiply_right(V* m) const {
    for (int i = 0; i < 9; i += 3) {
      m[i] *= scale, m[i + 1] *= scale;
      m[i + 2] -= m[i] * mean[0] + m[i + 1] * mean[1];
    }
  }
  // T^T m.
  KV_HD void multiply_left_transposed(V* m) const {
    for (int k = 0; k < 3; ++k) {
      m[k] *= scale, m[3 + k] *= scale;
      m[6 + k] -= m[k] * mean[0] + m[3 + k] * mean[1];
    }
  }
};

// Two orthonormal vectors that are orthogonal to seven rows, which it destroys.
template <class V>
KV_HD void null_space(V (&rows)[7][9], V (&basis)[2][9]) {
  V scales[7];  // reflection k is 1 - scales[k] v v^T, v in row k from entry k on
#pragma unroll
  for (int k = 0; k < 7; ++k) {
    V* const v = rows[k];
    V square{};
#pragma unroll
    for (int i = k; i < 9; ++i) square += v[i] * v[i];
    V const norm = root(square);
    V const signed_norm = v[k] < 0 ? V(-norm) : norm;
    scales[k] = 1 / (square + v[k] * signed_norm);
    v[k] += signed_norm;
#pragma unroll
    for (int r = k + 1; r < 7; ++r) {
      V projection{};
#pragma unroll
      for (int i = k; i < 9; ++i) projection += v[i] * rows[r][i];
      projection *= scales[k];
#pragma unroll
      for (int i = k; i < 9; ++i) rows[r][i] -= projection * v[i];
    }
  }
#pragma unroll
  for (int b = 0; b < 2; ++b) {
#pragma unroll
    for (int i = 0; i < 9; ++i) basis[b][i] = V{} + (i == 7 + b ? 1.0 : 0.0);
#pragma unroll
    for (int k = 6; k >= 0; --k) {
      V projection{};
#pragma unroll
      for (int i = k; i < 9; ++i) projection += rows[k][i] * basis[b][i];
      projection *= scales[k];
#pragma unroll
      for (int i = k; i < 9; ++i) basis[b][i] -= projection * rows[k][i];
    }
  }
}

// The real roots of x^3 + b x^2 + c x + d, NaN for others. With x = t - b / 3 it is t^3 + p t + q.
template <class V>
KV_HD void cubic_roots(V b, V c, V d, V (&roots)[3]) {
  V const zero{}, shift = b * (1.0 / 3);
  V const p = c - b * shift, q = d + shift * (2 * shift * shift - c), size = magnitude(q);
  V const half = root(size), bound = size < 1 ? root(half) : half;  // at least the cube root of |q|
  V const monotone = size / (p > 0 ? p : V(zero + 1)), outside = bound + root(p < 0 ? V(-p) : zero);
  V const start = p > 0 ? (monotone < bound ? monotone : bound) : outside;
  V x = (q < 0 ? start : V(-start)) - shift;
  for (int step = 0; step < 10; ++step) {
    V const value = ((x + b) * x + c) * x + d, slope = (3 * x + 2 * b) * x + c;
    x -= value / (slope != 0 ? slope : V(zero + 1));
  }
  V const sum = (b + x) * 0.5, product = c + x * (b + x), discriminant = sum * sum - product;
  V const distance = root(discriminant < 0 ? zero : discriminant),
          far = sum < 0 ? V(distance - sum) : V(-distance - sum);
  V const missing = zero + __builtin_nan("");
  roots[0] = x;
  roots[1] = discriminant < 0 ? missing : far;
  roots[2] = discriminant < 0 ? missing : V(product / (far != 0 ? far : V(zero + 1)));
  for (int i = 1; i < 3; ++i) {
    V const y = roots[i], value = ((y + b) * y + c) * y + d, slope = (3 * y + 2 * b) * y + c;
    V const step = value / (slope != 0 ? slope : V(zero + 1));
    roots[i] = magnitude(step) < 1e-3 * (magnitude(y) + 1e-3) ? V(y - step) : y;
  }
}

// Fundamental matrices of norm 1.
template <class V>
KV_HD void solve(V const (&x)[7][2], V const (&y)[7][2], V (&models)[3][9]) {
  Normalized<V> const one(x), two(y);
  V rows[7][9], basis[2][9], cofactors_D[9], cofactors_F[9], roots[3];
  for (int i = 0; i < 7; ++i) {
    V const u[] = {one.points[i][0], one.points[i][1], V{} + 1}, v[] = {two.points[i][0], two.points[i][1], V{} + 1};
    for (int k = 0; k < 9; ++k) rows[i][k] = v[k / 3] * u[k % 3];
  }
  null_space(rows, basis);
  V *const D = basis[0], *const F = basis[1];
  cofactors3(D, cofactors_D);
  cofactors3(F, cofactors_F);
  V cubic[] = {dot3(D, cofactors_D), V{}, V{}, dot3(F, cofactors_F)};
  for (int k = 0; k < 9; ++k) cubic[1] += cofactors_D[k] * F[k], cubic[2] += cofactors_F[k] * D[k];
  // The roots are finite and not many times larger than 1 if the first coefficient is larger than the last.
  auto const swaps = magnitude(cubic[0]) < magnitude(cubic[3]);
  V const inverse = 1 / (swaps ? cubic[3] : cubic[0]);
  cubic_roots<V>((swaps ? cubic[2] : cubic[1]) * inverse, (swaps ? cubic[1] : cubic[2]) * inverse,
                 (swaps ? cubic[0] : cubic[3]) * inverse, roots);
  for (int i = 0; i < 3; ++i) {
    V* const m = models[i];
    for (int k = 0; k < 9; ++k) m[k] = swaps ? V(roots[i] * F[k] + D[k]) : V(roots[i] * D[k] + F[k]);
    one.multiply_right(m);
    two.multiply_left_transposed(m);
    V square{};
    for (int k = 0; k < 9; ++k) square += m[k] * m[k];
    V const scale = 1 / root(square);
    for (int k = 0; k < 9; ++k) m[k] *= scale;
  }
}

}  // namespace kv::geometry::seven_points
