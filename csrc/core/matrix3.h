// 3 x 3 matrices, row by row, and vectors of three numbers. V is a number, Lanes or a Dual. Included by geometry's
// kernels.
#pragma once

#include "dual.h"

namespace kv {

template <class V>
KV_HD V dot3(V const* a, V const* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

template <class V>
KV_HD void cross3(V const* a, V const* b, V* c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

// c = a b, either of them transposed.
template <bool kTransposeA = false, bool kTransposeB = false, class V>
KV_HD void multiply3(V const* a, V const* b, V* c) {
  constexpr int kStrideA = kTransposeA ? 3 : 1, kStrideB = kTransposeB ? 1 : 3;
  for (int i = 0; i < 9; ++i) {
    V const *const row = a + (kTransposeA ? i / 3 : i / 3 * 3), *const column = b + (kTransposeB ? i % 3 * 3 : i % 3);
    c[i] = row[0] * column[0] + row[kStrideA] * column[kStrideB] + row[2 * kStrideA] * column[2 * kStrideB];
  }
}

// The cross products of the rows, as rows: the transpose of the adjugate.
template <class V>
KV_HD void cofactors3(V const* m, V* c) {
  cross3(m + 3, m + 6, c);
  cross3(m + 6, m, c + 3);
  cross3(m, m + 3, c + 6);
}

template <class V>
KV_HD void transpose3(V* m) {
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < i; ++k) {
      V const t = m[3 * i + k];
      m[3 * i + k] = m[3 * k + i];
      m[3 * k + i] = t;
    }
}

// The inverse times the determinant.
template <class V>
KV_HD void adjugate3(V const* m, V* a) {
  cofactors3(m, a);
  transpose3(a);
}

// The inverse, NaN where the matrix is singular; returns the determinant.
template <class V>
KV_HD V inverse3(V const* m, V* inverse) {
  V cofactors[9];
  cofactors3(m, cofactors);
  V const determinant = dot3(m, cofactors);
  V const factor = select(determinant == 0., constant<V>(__builtin_nan("")), 1. / determinant);
  for (int i = 0; i < 9; ++i) inverse[i] = cofactors[i % 3 * 3 + i / 3] * factor;
  return determinant;
}

// The gradient of m from that of its adjugate, which is transposed in place: row r0 is in r2 x r0 and r0 x r1, and so
// on.
template <class V>
KV_HD void adjugate3_vjp(V const* m, V* g, V* grad) {
  transpose3(g);
  for (int i = 0; i < 3; ++i) {
    int const j = (i + 1) % 3, k = (i + 2) % 3;
    V a[3], b[3];
    cross3(g + 3 * j, m + 3 * k, a);
    cross3(m + 3 * j, g + 3 * k, b);
    for (int e = 0; e < 3; ++e) grad[3 * i + e] = a[e] + b[e];
  }
}

}  // namespace kv
