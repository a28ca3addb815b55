// The coefficients of products of polynomials in x, y and z, and of determinants of polynomials in z: formulas of
// kvision.geometry.solvers.polynomials.
#pragma once

#include "geometry/formula.h"

namespace kv::geometry {

// Index tables of monomials. The product of two of x, y, z, 1 is one of x^2, xy, xz, x, y^2, yz, y, z^2, z, 1. The
// product of one of these ten and one of x, y, z, 1 is one of x^3, y^3, x^2 y, x y^2, x^2 z, x^2, y^2 z, y^2, xyz, xy,
// x z^2, xz, x, y z^2, yz, y, z^3, z^2, z, 1.
struct QuadraticMonomials {
  static constexpr int kLeft = 4, kCount = 10;
  static KV_HD int index(int i, int k) {
    constexpr unsigned char table[] = {0, 1, 2, 3, 1, 4, 5, 6, 2, 5, 7, 8, 3, 6, 8, 9};
    return table[4 * i + k];
  }
};
struct CubicMonomials {
  static constexpr int kLeft = 10, kCount = 20;
  static KV_HD int index(int i, int k) {
    constexpr unsigned char table[] = {0, 2, 4,  5,  2, 3, 8,  9,  4,  8,  10, 11, 5,  9,  11, 12, 3,  1,  6,  7,
                                       8, 6, 13, 14, 9, 7, 14, 15, 10, 13, 16, 17, 11, 14, 17, 18, 12, 15, 18, 19};
    return table[4 * i + k];
  }
};

// to += a b, for b of degree 1.
template <class Monomials, class V>
KV_HD void add_product(V const* a, V const* b, V* to) {
#pragma unroll
  for (int i = 0; i < Monomials::kLeft; ++i)
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      V& sum = to[Monomials::index(i, k)];
      sum = sum + a[i] * b[k];
    }
}

// The product of polynomials of degree one or two and of degree one.
template <class Monomials>
struct PolynomialProduct {
  static constexpr int kLeft = Monomials::kLeft, kInputs = 2, kRequired = 2, kInputSize = kLeft + 4,
                       kOutputSize = Monomials::kCount, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return {i == 0 ? kLeft : 4}; }
  static constexpr Extent result = {kOutputSize};

  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
#pragma unroll
    for (int i = 0; i < kOutputSize; ++i) y[i] = V{};
    add_product<Monomials>(x, x + kLeft, y);
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
#pragma unroll
    for (int i = 0; i < kInputSize; ++i) grad_x[i] = V{};
#pragma unroll
    for (int i = 0; i < kLeft; ++i)
#pragma unroll
      for (int k = 0; k < 4; ++k) {
        V const g = grad_y[Monomials::index(i, k)];
        grad_x[i] = grad_x[i] + g * x[kLeft + k];
        grad_x[kLeft + k] = grad_x[kLeft + k] + g * x[i];
      }
  }
};

// --- polynomials in z ------------------------------------------------------------------------------------------------

// to[i + k] += a[i] b[k] if Sign is 1, -= if it is -1.
template <int Left, int Right, int Sign, class V>
KV_HD void add_convolution(V const* a, V const* b, V* to) {
#pragma unroll
  for (int i = 0; i < Left; ++i)
#pragma unroll
    for (int k = 0; k < Right; ++k) to[i + k] = Sign > 0 ? to[i + k] + a[i] * b[k] : to[i + k] - a[i] * b[k];
}

// to[i] += sum over k of g[i + k] b[k], or -=: the vjp of add_convolution for one of its factors.
template <int Left, int Right, int Sign, class V>
KV_HD void add_correlation(V const* g, V const* b, V* to) {
#pragma unroll
  for (int i = 0; i < Left; ++i)
#pragma unroll
    for (int k = 0; k < Right; ++k) to[i] = Sign > 0 ? to[i] + g[i + k] * b[k] : to[i] - g[i + k] * b[k];
}

// The minor of the columns of degree three in rows `one` and `two` of 13 coefficients: u1 v2 - u2 v1.
template <class V>
KV_HD void cubic_minor(V const* one, V const* two, V* minor) {
#pragma unroll
  for (int i = 0; i < 7; ++i) minor[i] = V{};
  add_convolution<4, 4, 1>(one, two + 4, minor);
  add_convolution<4, 4, -1>(two, one + 4, minor);
}

// The determinant of a 3 x 3 matrix, each row of which has two polynomials of degree three and one of degree four, the
// highest power first. In the result it is last.
struct DeterminantToPolynomial {
  static constexpr int kInputs = 1, kRequired = 1, kInputSize = 39, kOutputSize = 11, kScalars = 0,
                       kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {3, 13}; }
  static constexpr Extent result = {11};

  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V det[11] = {};
#pragma unroll
    for (int row = 0; row < 3; ++row) {
      V minor[7];
      cubic_minor(x + (row + 1) % 3 * 13, x + (row + 2) % 3 * 13, minor);
      add_convolution<7, 5, 1>(minor, x + 13 * row + 8, det);
    }
#pragma unroll
    for (int i = 0; i < 11; ++i) y[i] = det[10 - i];
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V grad_det[11];
#pragma unroll
    for (int i = 0; i < 11; ++i) grad_det[i] = grad_y[10 - i];
#pragma unroll
    for (int i = 0; i < 39; ++i) grad_x[i] = V{};
#pragma unroll
    for (int row = 0; row < 3; ++row) {
      int const one = (row + 1) % 3 * 13, two = (row + 2) % 3 * 13, third = 13 * row + 8;
      V minor[7], grad_minor[7] = {};
      cubic_minor(x + one, x + two, minor);
      add_correlation<5, 7, 1>(grad_det, minor, grad_x + third);
      add_correlation<7, 5, 1>(grad_det, x + third, grad_minor);
      add_correlation<4, 4, 1>(grad_minor, x + two + 4, grad_x + one);
      add_correlation<4, 4, 1>(grad_minor, x + one, grad_x + two + 4);
      add_correlation<4, 4, -1>(grad_minor, x + one + 4, grad_x + two);
      add_correlation<4, 4, -1>(grad_minor, x + two, grad_x + one + 4);
    }
  }
};

}  // namespace kv::geometry
