// Local affine frames [A | c], 2 x 3: formulas of kvision.feature.laf, and of detectors.
//
//   x = a11 a12 cx a21 a22 cy, the numbers of a frame
//
// A frame of zeros is an empty slot. Functions leave it as it is, with finite derivatives.
#pragma once

#include "geometry/conversions/angles.h"

namespace kv::feature {

using namespace geometry;

// A formula of a frame to `Rows` x `Columns` numbers.
template <int Rows, int Columns = 0>
struct FrameInput {
  static constexpr int kInputs = 1, kRequired = 1, kInputSize = 6, kOutputSize = Columns ? Rows * Columns : Rows,
                       kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {2, 3}; }
  static constexpr Extent result = {Rows, Columns};
};

// A formula of a frame and an angle in degrees to a frame.
struct FrameAndAngle {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 7, kOutputSize = 6, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return i ? Extent{} : Extent{2, 3}; }
  static constexpr Extent result = {2, 3};
};

// The square root, 0 with a derivative of 0 where x is 0.
template <class V>
KV_HD V root_or_zero(V const& x) {
  auto const is_zero = x == 0.;
  return select(is_zero, constant<V>(0), square_root(select(is_zero, constant<V>(1), x)));
}

// sqrt |det A + 1e-10|; the constant keeps the derivative of empty slots finite.
template <class V>
KV_HD V frame_scale(V const* x) {
  V const det = x[0] * x[4] - x[1] * x[3] + 1e-10;
  return root_or_zero(select(det < 0., -det, det));
}

// [A R | c] for the rotation R = [[cos, sin], [-sin, cos]].
template <class V>
KV_HD void rotate_frame(V const* x, V const& cosine, V const& sine, V* y) {
  for (int i = 0; i < 6; i += 3) {
    y[i] = x[i] * cosine - x[i + 1] * sine;
    y[i + 1] = x[i] * sine + x[i + 1] * cosine;
    y[i + 2] = x[i + 2];
  }
}

// Cosine and sine of atan2(a12, a11); 1 and 0 where both are 0.
template <class V>
KV_HD void frame_orientation(V const* x, V& cosine, V& sine) {
  V const length = root_or_zero(x[0] * x[0] + x[1] * x[1]);
  auto const is_zero = length == 0.;
  V const divisor = select(is_zero, constant<V>(1), length);
  cosine = select(is_zero, constant<V>(1), x[0] / divisor), sine = x[1] / divisor;
}

struct LafScale : FrameInput<1> {
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    y[0] = frame_scale(x);
  }
};

struct RotateLaf : FrameAndAngle {
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V cosine, sine;
    cos_sin_degrees(x[6], cosine, sine);
    rotate_frame(x, cosine, sine, y);
  }
};

// Rotates by the difference of two angles, that of x[6] and the frame's own.
struct SetLafOrientation : FrameAndAngle {
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V cosine, sine, c, s;
    cos_sin_degrees(x[6], cosine, sine);
    frame_orientation(x, c, s);
    rotate_frame(x, cosine * c + sine * s, sine * c - cosine * s, y);
  }
};

// Inputs: center, scale, degrees.
struct LafFromParts {
  static constexpr int kInputs = 3, kRequired = 1, kInputSize = 4, kOutputSize = 6, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return i ? Extent{} : Extent{2}; }
  static constexpr Extent result = {2, 3};
  static KV_HD double default_value(int i, FormulaOptions const&) { return i == 2; }
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V cosine, sine;
    cos_sin_degrees(x[3], cosine, sine);
    y[0] = x[2] * cosine, y[1] = x[2] * sine, y[2] = x[0];
    y[3] = -y[1] + 0., y[4] = y[0], y[5] = x[1];
  }
};

// [k A | (sx, sy) c] for scalars k, sx, sy.
struct ScaleLafParts : FrameInput<2, 3> {
  static constexpr int kScalars = 3;
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const& s) {
    for (int i = 0; i < 6; ++i) y[i] = x[i] * s.scalars[i == 2 ? 1 : i == 5 ? 2 : 0];
  }
};

// The upright frame of a peak (level, x, y, value) of an octave whose level 0 has scale s_0: the scale s_0 2^(level /
// n), in pixels of an image, of which those of the octave are (sx, sy).
struct LafOfPeak {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 5, kOutputSize = 6, kScalars = 3, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return i ? Extent{} : Extent{4}; }
  static constexpr Extent result = {2, 3};
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const& s) {
    V const scale = x[4] * power_of_two(x[0] / s.scalars[0]);
    y[0] = scale * s.scalars[1], y[1] = constant<V>(0), y[2] = x[1] * s.scalars[1];
    y[3] = constant<V>(0), y[4] = scale * s.scalars[2], y[5] = x[2] * s.scalars[2];
  }
};

// The lower triangular U with U U^T = A A^T:  r = |(a11, a12)| + eps,  U = [[r, 0], [row1 . row2 / r, scale^2 / r]].
struct MakeUpright : FrameInput<2, 3> {
  static constexpr int kScalars = 1;
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const& s) {
    // The square of a scale is not negative, so that the sum of squares is 0 for an empty slot alone.
    V sum = squared_norm(x, 6);
    auto const is_empty = sum == 0.;
    V const r = root_or_zero(x[0] * x[0] + x[1] * x[1]) + s.scalars[0], scale = frame_scale(x);
    y[0] = select(is_empty, x[0], r), y[1] = select(is_empty, x[1], constant<V>(0)), y[2] = x[2];
    y[3] = select(is_empty, x[3], (x[4] * x[1] + x[3] * x[0]) / r);
    y[4] = select(is_empty, x[4], scale * scale / r), y[5] = x[5];
  }
};

// The ellipse a u^2 + 2 b u v + c v^2 = 1 around (x, y): the Cholesky factor of the inverse of [[a, b], [b, c]].
struct EllipseToLaf : VectorInput<5, 2, 3> {
  template <class V>
  static KV_HD void evaluate(V const* e, V* y, FormulaOptions const&) {
    V const root = square_root(e[4]), slope = e[3] / root, schur = square_root(e[2] - slope * slope);
    y[0] = constant<V>(1) / schur, y[1] = constant<V>(0), y[2] = e[0];
    y[3] = -slope / (root * schur), y[4] = constant<V>(1) / root, y[5] = e[1];
  }
};

// Inputs: a homography, a frame. Points are mapped as transform_points does: without a division where |w| <= 1e-8.
struct PerspectiveTransformLaf {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 15, kOutputSize = 6, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int i) { return i ? Extent{2, 3} : Extent{3, 3}; }
  static constexpr Extent result = {2, 3};
  template <class V>
  static KV_HD void map(V const* h, V const& px, V const& py, V& x, V& y) {
    V const w = h[6] * px + h[7] * py + h[8];
    auto const is_far = (w > 1e-8) | (w < -1e-8);
    V const factor = constant<V>(1) / select(is_far, w, constant<V>(1));
    x = (h[0] * px + h[1] * py + h[2]) * factor, y = (h[3] * px + h[4] * py + h[5]) * factor;
  }
  template <class V>
  static KV_HD void evaluate(V const* h, V* y, FormulaOptions const&) {
    V const* f = h + 9;
    map(h, f[2], f[5], y[2], y[5]);
    for (int i = 0; i < 2; ++i) {
      map(h, f[2] + f[i], f[5] + f[3 + i], y[i], y[3 + i]);
      y[i] = y[i] - y[2], y[3 + i] = y[3 + i] - y[5];
    }
  }
};

// The offset (x, y) of the top of the quadratic through 3 x 3 values v, row by row, from the middle; 0 where it has no
// top or one that is more than a pixel away.
struct QuadraticPeak2d : VectorInput<9, 2> {
  template <class V>
  static KV_HD void evaluate(V const* v, V* y, FormulaOptions const&) {
    V const dx = (v[5] - v[3]) * .5, dy = (v[7] - v[1]) * .5;
    V const xx = v[5] - v[4] * 2. + v[3], yy = v[7] - v[4] * 2. + v[1], xy = (v[8] - v[6] - v[2] + v[0]) * .25;
    V const det = xx * yy - xy * xy;
    auto const has_top = (det > 0.) & (xx < 0.);
    V const divisor = select(has_top, det, constant<V>(1));
    V const across = (xy * dy - yy * dx) / divisor, down = (xy * dx - xx * dy) / divisor;
    auto const near = has_top & (across * across <= 1.) & (down * down <= 1.);
    y[0] = select(near, across, constant<V>(0)), y[1] = select(near, down, constant<V>(0));
  }
};

}  // namespace kv::feature
