// Rigid transformations of space, (4, 4) matrices whose last row is assumed to be 0 0 0 1: formulas of
// kvision.geometry.linalg.
#pragma once

#include "geometry/formula.h"

namespace kv::geometry {

template <int N>
struct PoseInputs {
  static constexpr int kInputs = N, kRequired = N, kInputSize = 16 * N, kOutputSize = 16, kScalars = 0,
                       kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {4, 4}; }
  static constexpr Extent result = {4, 4};
};

template <class V>
KV_HD void write_last_row(V* m, double last) {
  for (int i = 12; i < 16; ++i) m[i] = constant<V>(i == 15 ? last : 0);
}

// c = R b and c = R^T b for the rotation R of pose a; b and c have three rows of four numbers.
template <class V>
KV_HD void rotate(V const* a, V const* b, V* c) {
  for (int i = 0; i < 12; ++i) {
    V const* const row = a + i / 4 * 4;
    c[i] = row[0] * b[i % 4] + row[1] * b[4 + i % 4] + row[2] * b[8 + i % 4];
  }
}
template <class V>
KV_HD void rotate_inverse(V const* a, V const* b, V* c) {
  for (int i = 0; i < 12; ++i) {
    V const* const column = a + i / 4;
    c[i] = column[0] * b[i % 4] + column[4] * b[4 + i % 4] + column[8] * b[8 + i % 4];
  }
}

// R1 R2, R1 t2 + t1.
struct ComposePoses : PoseInputs<2> {
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    rotate(x, x + 16, m);
    for (int i = 3; i < 12; i += 4) m[i] = m[i] + x[i];
    write_last_row(m, 1);
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    for (int i = 0; i < 12; ++i) {
      V const *const a = grad_y + i / 4 * 4, *const b = x + 16 + i % 4 * 4;
      grad_x[i] = i % 4 == 3 ? grad_y[i] : a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    }
    rotate_inverse(x, grad_y, grad_x + 16);
    write_last_row(grad_x, 0);
    write_last_row(grad_x + 16, 0);
  }
};

// R^T, -R^T t.
struct InvertPose : PoseInputs<1> {
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) m[4 * i + k] = x[4 * k + i];
      m[4 * i + 3] = -(x[i] * x[3] + x[4 + i] * x[7] + x[8 + i] * x[11]);
    }
    write_last_row(m, 1);
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    for (int i = 0; i < 3; ++i) {
      V const *const row = x + 4 * i, t = row[3];
      for (int k = 0; k < 3; ++k) grad_x[4 * i + k] = grad_y[4 * k + i] - t * grad_y[4 * k + 3];
      grad_x[4 * i + 3] = -(row[0] * grad_y[3] + row[1] * grad_y[7] + row[2] * grad_y[11]);
    }
    write_last_row(grad_x, 0);
  }
};

// R1^T R2, R1^T (t2 - t1).
struct RelativePose : PoseInputs<2> {
  template <class V>
  static KV_HD void translate_back(V const* x, V* s) {
    for (int i = 0; i < 12; ++i) s[i] = i % 4 == 3 ? x[16 + i] - x[i] : x[16 + i];
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    V s[12];
    translate_back(x, s);
    rotate_inverse(x, s, m);
    write_last_row(m, 1);
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V s[12];
    translate_back(x, s);
    rotate(x, grad_y, grad_x + 16);
    for (int i = 0; i < 12; ++i) {
      V const *const a = s + i / 4 * 4, *const b = grad_y + i % 4 * 4;
      grad_x[i] = i % 4 == 3 ? -grad_x[16 + i] : a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    }
    write_last_row(grad_x, 0);
    write_last_row(grad_x + 16, 0);
  }
};

}  // namespace kv::geometry
