// Matrices of two views, fundamental, essential, relative motions and projections: formulas of
// kvision.geometry.epipolar.
#pragma once

#include "core/matrix3.h"
#include "geometry/formula.h"
#include "geometry/relative_motion.h"

namespace kv::geometry {

// y = right^T m left, and the gradients to all three.
template <class V>
KV_HD void bilinear_product(V const* m, V const* left, V const* right, V* y) {
  V product[9];
  multiply3<false, false>(m, left, product);
  multiply3<true, false>(right, product, y);
}
template <class V>
KV_HD void bilinear_product_vjp(V const* m, V const* left, V const* right, V const* grad_y, V* grad_m, V* grad_left,
                                V* grad_right) {
  V product[9];
  multiply3<false, false>(m, left, product);
  multiply3<false, true>(product, grad_y, grad_right);
  multiply3<false, false>(right, grad_y, product);
  multiply3<false, true>(product, left, grad_m);
  multiply3<true, false>(m, product, grad_left);
}

// Inputs: a matrix and two cameras.
struct CameraInputs {
  static constexpr int kInputs = 3, kRequired = 3, kInputSize = 27, kOutputSize = 9, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {3, 3}; }
  static constexpr Extent result = {3, 3};
};

struct EssentialFromFundamental : CameraInputs {
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    bilinear_product(x, x + 9, x + 18, y);
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    bilinear_product_vjp(x, x + 9, x + 18, grad_y, grad_x, grad_x + 9, grad_x + 18);
  }
};

struct FundamentalFromEssential : CameraInputs {
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V left[9], right[9];
    inverse3(x + 9, left);
    inverse3(x + 18, right);
    bilinear_product(x, left, right, y);
  }
  // The gradient to K is -K^-T G K^-T for the gradient G to K^-1.
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V inverses[18], grad_inverses[18], product[9];
    inverse3(x + 9, inverses);
    inverse3(x + 18, inverses + 9);
    bilinear_product_vjp(x, inverses, inverses + 9, grad_y, grad_x, grad_inverses, grad_inverses + 9);
    for (int i = 0; i < 18; i += 9) {
      multiply3<true, false>(inverses + i, grad_inverses + i, product);
      multiply3<false, true>(product, inverses + i, grad_x + 9 + i);
      for (int k = 0; k < 9; ++k) grad_x[9 + i + k] = -grad_x[9 + i + k];
    }
  }
};

// A line (a, b, c) over the length of (a, b), itself where that is 0.
struct NormalizeLine : VectorInput<3, 3> {
  template <class V>
  static KV_HD V length(V const* x) {
    V const square = x[0] * x[0] + x[1] * x[1];
    return square_root(select(square == 0., constant<V>(1), square));
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V const n = length(x);
    for (int i = 0; i < 3; ++i) y[i] = x[i] / n;
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V const n = length(x), along = dot3(grad_y, x) / (n * n);
    grad_x[0] = (grad_y[0] - along * x[0]) / n;
    grad_x[1] = (grad_y[1] - along * x[1]) / n;
    grad_x[2] = grad_y[2] / n;
  }
};

// Inputs: rotations and translations of two cameras.
struct MotionInputs {
  static constexpr int kInputs = 4, kRequired = 4, kInputSize = 24, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return {3, i % 2 ? 1 : 3}; }

  template <class V>
  static KV_HD void motion(V const* x, V* R, V* t) {
    relative_motion(x, x + 9, x + 12, x + 21, R, t);
  }
  template <class V>
  static KV_HD void motion_vjp(V const* x, V const* R, V const* grad_R, V const* grad_t, V* grad_x) {
    relative_motion_vjp(x, x + 9, x + 12, R, grad_R, grad_t, grad_x, grad_x + 9, grad_x + 12);
    for (int i = 0; i < 3; ++i) grad_x[21 + i] = grad_t[i];
  }
};

// The rows of R, then t.
struct CameraMotion : MotionInputs {
  static constexpr int kOutputSize = 12;
  static constexpr Extent result = {4, 3};
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    motion(x, y, y + 9);
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V R[9], t[3];
    motion(x, R, t);
    motion_vjp(x, R, grad_y, grad_y + 9, grad_x);
  }
};

// [t]x R.
struct EssentialFromMotions : MotionInputs {
  static constexpr int kOutputSize = 9;
  static constexpr Extent result = {3, 3};
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V R[9], t[3];
    motion(x, R, t);
    for (int i = 0; i < 9; ++i) {
      int const after = (i / 3 + 1) % 3, last = (i / 3 + 2) % 3;
      y[i] = t[after] * R[3 * last + i % 3] - t[last] * R[3 * after + i % 3];
    }
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V R[9], t[3], grad_R[9], grad_t[3];
    motion(x, R, t);
    for (int i = 0; i < 3; ++i) {
      V const *const R1 = R + (i + 1) % 3 * 3, *const R2 = R + (i + 2) % 3 * 3, *const g1 = grad_y + (i + 1) % 3 * 3,
                     *const g2 = grad_y + (i + 2) % 3 * 3;
      grad_t[i] = constant<V>(0);
      for (int k = 0; k < 3; ++k) {
        grad_t[i] = grad_t[i] + (R1[k] * g2[k] - R2[k] * g1[k]);
        grad_R[3 * i + k] = g1[k] * t[(i + 2) % 3] - g2[k] * t[(i + 1) % 3];
      }
    }
    motion_vjp(x, R, grad_R, grad_t, grad_x);
  }
};

// F's entries are determinants of four rows, two of each projection; a row of both is left out (R. Hartley, A.
// Zisserman, 17.3). By Laplace's rule each is a sum over pairs of columns: a minor of the first projection times that
// of the second one for the other two columns.
struct FundamentalFromProjections {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 24, kOutputSize = 9, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {3, 4}; }
  static constexpr Extent result = {3, 3};

  // Columns of pair `i` of projection `which`: those of projection 0 ascend, those of projection 1 are the other two.
  static KV_HD int column(int which, int i, int k) {
    constexpr int columns[2][6][2] = {{{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}},
                                      {{2, 3}, {3, 1}, {1, 2}, {0, 3}, {2, 0}, {0, 1}}};
    return columns[which][i][k];
  }
  template <class V>
  static KV_HD void minors(V const* p, int which, V* m) {
    for (int r = 0; r < 3; ++r) {
      V const *const a = p + (r + 1) % 3 * 4, *const b = p + (r + 2) % 3 * 4;
      for (int i = 0; i < 6; ++i) {
        int const c = column(which, i, 0), d = column(which, i, 1);
        m[6 * r + i] = a[c] * b[d] - a[d] * b[c];
      }
    }
  }
  template <class V>
  static KV_HD void minors_vjp(V const* p, int which, V const* grad_y, V* grad_x) {
    for (int i = 0; i < 12; ++i) grad_x[i] = constant<V>(0);
    for (int r = 0; r < 3; ++r) {
      int const first = (r + 1) % 3 * 4, second = (r + 2) % 3 * 4;
      for (int i = 0; i < 6; ++i) {
        int const c = column(which, i, 0), d = column(which, i, 1);
        V const& grad = grad_y[6 * r + i];
        grad_x[first + c] = grad_x[first + c] + grad * p[second + d],
                       grad_x[first + d] = grad_x[first + d] - grad * p[second + c];
        grad_x[second + d] = grad_x[second + d] + grad * p[first + c],
                        grad_x[second + c] = grad_x[second + c] - grad * p[first + d];
      }
    }
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V one[18], two[18];
    minors(x, 0, one);
    minors(x + 12, 1, two);
    for (int i = 0; i < 9; ++i) {
      y[i] = constant<V>(0);
      for (int k = 0; k < 6; ++k) y[i] = y[i] + two[i / 3 * 6 + k] * one[i % 3 * 6 + k];
    }
  }
  template <class V>
  static KV_HD void vjp(V const* x, V const* grad_y, V* grad_x, FormulaOptions const&) {
    V one[18], two[18], grad_minors1[18], grad_minors2[18];
    minors(x, 0, one);
    minors(x + 12, 1, two);
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 6; ++k) {
        grad_minors1[6 * r + k] = grad_y[r] * two[k] + grad_y[3 + r] * two[6 + k] + grad_y[6 + r] * two[12 + k];
        grad_minors2[6 * r + k] =
            grad_y[3 * r] * one[k] + grad_y[3 * r + 1] * one[6 + k] + grad_y[3 * r + 2] * one[12 + k];
      }
    minors_vjp(x, 0, grad_minors1, grad_x);
    minors_vjp(x + 12, 1, grad_minors2, grad_x + 12);
  }
};

// Decomposes a projection K [R | t] into the rows of K, upper triangular, the rows of R, and t. The rows of its left 3
// x 3 part are made orthogonal, the last one first (RQ decomposition by Gram-Schmidt).
struct DecomposeProjection : VectorInput<12, 7, 3> {
  static constexpr Extent extent(int) { return {3, 4}; }

  // Normalizes x - a one - b two, and returns its length.
  template <class V>
  static KV_HD V unit(V const* x, V const& a, V const* one, V const& b, V const* two, V* direction) {
    for (int i = 0; i < 3; ++i) direction[i] = x[i] - a * one[i] - b * two[i];
    V const size = square_root(dot3(direction, direction));
    for (int i = 0; i < 3; ++i) direction[i] = direction[i] / size;
    return size;
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V const *const a = x, *const b = x + 4, *const c = x + 8, zero = constant<V>(0);
    V first[3], second[3], third[3], across[3];
    V const f = unit(c, zero, c, zero, c, third), e = dot3(b, third), d = unit(b, e, third, zero, third, second);
    V const m = dot3(a, second), n = dot3(a, third), h = unit(a, m, second, n, third, first);
    cross3(first, second, across);
    V const sign = select(dot3(across, third) < 0., constant<V>(-1), constant<V>(1));
    V const K[] = {h, m, n, zero, d, e, zero, zero, f};
    for (int i = 0; i < 9; ++i) y[i] = K[i];
    for (int i = 0; i < 3; ++i) y[9 + i] = first[i] * sign, y[12 + i] = second[i] * sign, y[15 + i] = third[i] * sign;
    y[20] = c[3] * sign / f;
    y[19] = (b[3] * sign - e * y[20]) / d;
    y[18] = (a[3] * sign - m * y[19] - n * y[20]) / h;
  }
};

}  // namespace kv::geometry
