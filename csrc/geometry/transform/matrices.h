// Matrices of transforms of images and volumes: formulas of kvision.geometry.transform.matrices and crop.
#pragma once

#include "core/matrix3.h"
#include "geometry/conversions/rotations.h"

namespace kv::geometry {

// The affine map x -> linear (x - center) + center + translation in n dimensions, as n + 1 rows of n + 1 numbers.
template <int n, class V>
KV_HD void write_affine(V const* linear, V const* center, V const* translation, V* m) {
  for (int i = 0; i < n; ++i) {
    V offset = center[i];
    if (translation) offset = offset + translation[i];
    for (int k = 0; k < n; ++k) {
      offset = offset - linear[n * i + k] * center[k];
      m[(n + 1) * i + k] = linear[n * i + k] + 0.;  // no negative zeros
    }
    m[(n + 1) * i + n] = offset + 0.;
  }
  for (int k = 0; k <= n; ++k) m[(n + 1) * n + k] = constant<V>(k == n);
}

// Inputs: an angle in degrees, translation, scale, shear angles along x and y, center (scalars where it is missing).
// Shears, scales and rotates about the center, then translates.
struct AffineMatrix2d {
  static constexpr int kInputs = 6, kRequired = 1, kInputSize = 9, kOutputSize = 9, kScalars = 3, kOptionalLastRow = 1;
  static constexpr Extent extent(int i) { return {i == 1 || i == 2 || i == 5 ? 2 : 0}; }
  static constexpr Extent result = {3, 3};
  static KV_HD double default_value(int i, FormulaOptions const& s) {
    return i >= 7 ? s.scalars[i - 6] : i == 3 || i == 4;
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const& options) {
    V c, s;
    cos_sin_degrees(x[0] * options.scalars[0], c, s);
    V const *const scale = x + 3, a = tangent(x[5]), b = tangent(x[6]);
    V const right[] = {scale[0] * c, -scale[0] * s}, down[] = {scale[1] * s, scale[1] * c};
    V linear[4];
    for (int i = 0; i < 2; ++i) {
      linear[2 * i] = right[i] - b * down[i];
      linear[2 * i + 1] = down[i] - a * linear[2 * i];
    }
    write_affine<2>(linear, x + 7, x + 1, m);
  }
};

// Inputs: a translation, 0 where it is missing. The scalars are added to it.
template <int n>
struct TranslationMatrix : VectorInput<n, n + 1, n + 1> {
  static constexpr int kRequired = 0, kScalars = n, kOptionalLastRow = 1;
  static KV_HD double default_value(int, FormulaOptions const&) { return 0; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const& s) {
    for (int i = 0; i < (n + 1) * (n + 1); ++i) m[i] = constant<V>(i % (n + 2) == 0);
    for (int i = 0; i < n; ++i) m[(n + 1) * i + n] = x[i] + s.scalars[i];
  }
};
using TranslationMatrix2d = TranslationMatrix<2>;
using TranslationMatrix3d = TranslationMatrix<3>;

// Inputs: scales and a center (scalars where it is missing).
struct ScaleMatrix2d {
  static constexpr int kInputs = 2, kRequired = 1, kInputSize = 4, kOutputSize = 6, kScalars = 2, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {2}; }
  static constexpr Extent result = {2, 3};
  static KV_HD double default_value(int i, FormulaOptions const& s) { return s.scalars[i - 2]; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    for (int i = 0; i < 6; ++i) m[i] = constant<V>(0);
    m[0] = x[0], m[4] = x[1];
    m[2] = x[2] - x[0] * x[2] + 0., m[5] = x[3] - x[1] * x[3] + 0.;
  }
};

// Inputs: a center, and angles of shears along x, then y.
struct ShearMatrix2d {
  static constexpr int kInputs = 3, kRequired = 1, kInputSize = 4, kOutputSize = 9, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return {i == 0 ? 2 : 0}; }
  static constexpr Extent result = {3, 3};
  static KV_HD double default_value(int, FormulaOptions const&) { return 0; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    V const a = tangent(x[2]), b = tangent(x[3]);
    V const linear[] = {constant<V>(1), -a, -b, 1. + a * b};
    write_affine<2>(linear, x, static_cast<V const*>(nullptr), m);
  }
};

struct ShearFactorMatrix2d : VectorInput<2, 2, 3> {
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    for (int i = 0; i < 6; ++i) m[i] = constant<V>(i % 4 == 0);
    m[1] = x[0], m[3] = x[1];
  }
};

struct InvertAffine2d : VectorInput<6, 2, 3> {
  static constexpr Extent extent(int) { return {2, 3}; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    V const determinant = x[0] * x[4] - x[1] * x[3];
    m[0] = x[4] / determinant + 0., m[1] = -x[1] / determinant + 0.;
    m[3] = -x[3] / determinant + 0., m[4] = x[0] / determinant + 0.;
    m[2] = (x[1] * x[5] - x[4] * x[2]) / determinant + 0.;
    m[5] = (x[3] * x[2] - x[0] * x[5]) / determinant + 0.;
  }
};

template <class V>
KV_HD void shear_matrix3(V const* angles, V* m) {
  V t[6];
  for (int i = 0; i < 6; ++i) t[i] = -tangent(angles[i]);
  V const &xy = t[0], &xz = t[1], &yx = t[2], &yz = t[3], &zx = t[4], &zy = t[5];
  m[0] = constant<V>(1), m[1] = yx, m[2] = zx + yx * zy;
  m[3] = xy, m[4] = xy * m[1] + 1., m[5] = xy * m[2] + zy;
  m[6] = xz, m[7] = xz * m[1] + yz, m[8] = xz * m[2] + yz * zy + 1.;
}

// Inputs: an axis times an angle in degrees (three tensors), translation, scale, center (scalars where it is missing),
// six shear angles.
struct AffineMatrix3d {
  static constexpr int kInputs = 12, kRequired = 3, kInputSize = 18, kOutputSize = 16, kScalars = 4,
                       kOptionalLastRow = 1;
  static constexpr Extent extent(int i) { return {i >= 3 && i < 6 ? 3 : 0}; }
  static constexpr Extent result = {4, 4};
  static KV_HD double default_value(int i, FormulaOptions const& s) {
    return i >= 9 && i < 12 ? s.scalars[i - 8] : i >= 6 && i < 9;
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const& s) {
    V v[3], rotation[9], shear[9], linear[9];
    for (int i = 0; i < 3; ++i) v[i] = x[i] * (s.scalars[0] * 0.017453292519943295769);
    rotation_from_axis_angle(v, rotation);
    shear_matrix3(x + 12, shear);
    for (int i = 0; i < 9; ++i) rotation[i] = rotation[i] * x[6 + i % 3];
    multiply3(rotation, shear, linear);
    write_affine<3>(linear, x + 9, x + 3, m);
  }
};

struct ShearMatrix3d {
  static constexpr int kInputs = 7, kRequired = 1, kInputSize = 9, kOutputSize = 16, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return {i == 0 ? 3 : 0}; }
  static constexpr Extent result = {4, 4};
  static KV_HD double default_value(int, FormulaOptions const&) { return 0; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    V linear[9];
    shear_matrix3(x + 3, linear);
    write_affine<3>(linear, x, static_cast<V const*>(nullptr), m);
  }
};

// The homography that takes (0, 0), (1, 0), (1, 1), (0, 1) to four points (P. Heckbert, 1989), up to a factor:
//
//   w (p1 - p0) + g p1    w (p3 - p0) + h p3    w p0        g = s x v    s = p0 - p1 + p2 - p3
//   g                     h                     w           h = u x s    u = p1 - p2
//                                                           w = u x v    v = p3 - p2
template <class V>
KV_HD void from_unit_square(V const* p, V* m) {
  V const u[] = {p[2] - p[4], p[3] - p[5]}, v[] = {p[6] - p[4], p[7] - p[5]};
  V const s[] = {p[0] - p[2] - v[0], p[1] - p[3] - v[1]};
  V const g = s[0] * v[1] - s[1] * v[0], h = u[0] * s[1] - u[1] * s[0], area = u[0] * v[1] - u[1] * v[0];
  // All three are 0 for a box without area, which is treated as a parallelogram.
  V const or_parallelogram = select(s[0] == 0., select(s[1] == 0., constant<V>(1), area), area),
          w = select(area == 0., or_parallelogram, area);
  for (int i = 0; i < 2; ++i) {
    m[3 * i] = w * (p[2 + i] - p[i]) + g * p[2 + i];
    m[3 * i + 1] = w * (p[6 + i] - p[i]) + h * p[6 + i];
    m[3 * i + 2] = w * p[i];
  }
  m[6] = g, m[7] = h, m[8] = w;
}

struct PerspectiveMatrix {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 16, kOutputSize = 9, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {4, 2}; }
  static constexpr Extent result = {3, 3};
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    V src[9], dst[9], inverse[9];
    from_unit_square(x, src);
    from_unit_square(x + 8, dst);
    adjugate3(src, inverse);  // the inverse up to a factor
    multiply3(dst, inverse, m);
    V const last = m[8];
    for (int i = 0; i < 9; ++i) m[i] = m[i] / last + 0.;
  }
};

// From pixels of a crop to pixels of the image: the rectangle of the crop that starts at the second input, (0, 0) where
// it is missing, maps to a quadrangle. The scalars are the distances from its first pixels to its last ones, or 1.
struct CropMatrix {
  static constexpr int kInputs = 2, kRequired = 1, kInputSize = 10, kOutputSize = 9, kScalars = 2, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return i == 0 ? Extent{4, 2} : Extent{2}; }
  static constexpr Extent result = {3, 3};
  static KV_HD double default_value(int, FormulaOptions const&) { return 0; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const& s) {
    from_unit_square(x, m);
    V const scale = select(m[8] == 0., constant<V>(1), m[8]);
    for (int i = 0; i < 9; ++i) m[i] = m[i] / scale;  // exact for whole boxes
    for (int i = 0; i < 3; ++i) {
      V* const row = m + 3 * i;
      row[0] = row[0] / constant<V>(s.scalars[0]), row[1] = row[1] / constant<V>(s.scalars[1]);
      row[2] = row[2] - row[0] * x[8] - row[1] * x[9];
    }
  }
};

// The homography of space that takes five points, no four of them in a plane, to others: the corners 0, 1, 2, 5 and 7
// of boxes. It takes each of the first four, p_i, to q_i times a factor. That factor is the ratio of the volumes which
// the fifth point spans with the other three, in dst and in src. Row i of the inverse of the matrix of p_i is the plane
// through the other three. Missing destinations are the corners of the box from 0 to the scalars.
struct PerspectiveMatrix3d {
  static constexpr int kInputs = 2, kRequired = 1, kInputSize = 48, kOutputSize = 16, kScalars = 3,
                       kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {8, 3}; }
  static constexpr Extent result = {4, 4};
  static KV_HD double default_value(int i, FormulaOptions const& s) {
    int const point = i / 3 % 8, axis = i % 3;
    bool const far = axis == 2 ? point >= 4 : axis == 1 ? point % 4 >= 2 : point % 4 == 1 || point % 4 == 2;
    return far ? s.scalars[axis] : 0;
  }

  static KV_HD int corner(int i) { return i < 3 ? i : 2 * i - 1; }
  // The plane through the first four points without point i, and its value at the fifth.
  template <class V>
  static KV_HD V plane(V const* x, int i, V* n) {
    V const *const a = x + 3 * corner(i == 0 ? 1 : 0), *const b = x + 3 * corner(i <= 1 ? 2 : 1),
                   *const c = x + 3 * corner(i == 3 ? 2 : 3), *const last = x + 3 * corner(4);
    V u[3], v[3];
    for (int k = 0; k < 3; ++k) u[k] = b[k] - a[k], v[k] = c[k] - a[k];
    for (int k = 0; k < 3; ++k) {
      int const l = (k + 1) % 3, m = (k + 2) % 3;
      n[k] = i % 2 ? u[m] * v[l] - u[l] * v[m] : u[l] * v[m] - u[m] * v[l];
    }
    n[3] = -(n[0] * a[0] + n[1] * a[1] + n[2] * a[2]);
    return n[0] * (last[0] - a[0]) + n[1] * (last[1] - a[1]) + n[2] * (last[2] - a[2]);
  }
  template <class V>
  static KV_HD void evaluate(V const* x, V* m, FormulaOptions const&) {
    for (int i = 0; i < 16; ++i) m[i] = constant<V>(0);
    for (int i = 0; i < 4; ++i) {
      V plane_src[4], plane_dst[4];
      V const volume = plane(x, i, plane_src),
              factor = plane(x + 24, i, plane_dst) / volume, *const q = x + 24 + 3 * corner(i);
      for (int k = 0; k < 4; ++k) {
        V const weight = factor * plane_src[k];
        for (int row = 0; row < 3; ++row) m[4 * row + k] = m[4 * row + k] + q[row] * weight;
        m[12 + k] = m[12 + k] + weight;
      }
    }
    V const last = m[15];
    for (int i = 0; i < 16; ++i) m[i] = m[i] / last;
  }
};

// Of two quadrangles: the differences of opposite sides, x and y of each, and the diagonal of the second one from its
// first corner to its third.
struct CropBoxChecks {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 16, kOutputSize = 6, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {4, 2}; }
  static constexpr Extent result = {6};
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    for (int i = 0; i < 4; ++i) {
      V const* const p = x + i / 2 * 8 + i % 2;
      y[i] = p[2] - p[0] - p[4] + p[6];
    }
    for (int i = 0; i < 2; ++i) y[4 + i] = x[12 + i] - x[8 + i];
  }
};

}  // namespace kv::geometry
