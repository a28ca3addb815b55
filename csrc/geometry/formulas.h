// Rotations in all their forms, the matrices of transforms of images and of two views, as formulas (formula.h); the
// list of them is at the end. The Python references say what each is, python/kvision/geometry/{conversions,linalg,
// transform,epipolar}.
//
// What is 0 / 0 where an angle is 0 is a series in its square there; the other branches of a `select` may then be NaN,
// which stays there, in Duals too.
#pragma once

#include "core/trigonometry.h"
#include "geometry/formula.h"

namespace kv {

// --- functions of an angle -------------------------------------------------------------------------------------------

template <class V>
KV_HD V number(double x) {
  return constant<V>(x);
}

// sin(x) / x and cos(x) of x squared.
template <class V>
KV_HD void sinc_cos(V const& square, V& sinc, V& cosine) {
  V const x = square_root(square);
  V sine;
  sin_cos(x, sine, cosine);
  auto const small = square < 1e-3;
  sinc = select(small, 1. - square * (1 / 6.) * (1. - square * (1 / 20.) * (1. - square * (1 / 42.))), sine / x);
  cosine = select(small, 1. - square * .5 * (1. - square * (1 / 12.) * (1. - square * (1 / 30.))), cosine);
}

// atan2(s, c) / s of s squared; 0 where s is 0 and c is not positive.
template <class V>
KV_HD V angle_per_sine(V const& sine, V const& cosine, double tiny) {
  V const square = cosine * cosine, ratio = sine / square, s = square_root(sine);
  V const series = (1. - ratio * (1 / 3. - ratio * (1 / 5. - ratio * (1 / 7.)))) / cosine;
  V const angle = select(sine < tiny, number<V>(0), arctan2(s, cosine) / s);
  return select(cosine > 0., select(sine < square * 1e-4, series, angle), angle);
}

// Cosine and sine of degrees, exact at quarter turns.
template <class V>
KV_HD void of_degrees(V const& degrees, V& cosine, V& sine) {
  auto const quarters = rounded(degrees * (1 / 90.));
  V const rest = subtract_constant(degrees, quarters * 90.) * 0.017453292519943295769;
  V s, c;
  sin_cos(rest, s, c);
  auto const turn = quarters - rounded(quarters * .25) * 4.;  // -2 and 2 are the same
  V const half_c = select(turn * turn == 4., -c, c), half_s = select(turn * turn == 4., -s, s);
  cosine = select(turn == 1., -s, select(turn == -1., s, half_c)) + 0.;  // no negative zeros
  sine = select(turn == 1., c, select(turn == -1., -c, half_s)) + 0.;
}

template <class V>
KV_HD V tangent(V const& angle) {
  V s, c;
  sin_cos(angle, s, c);
  return s / c;
}

template <class V>
KV_HD V squared(V const* x, int n) {
  V sum = x[0] * x[0];
  for (int i = 1; i < n; ++i) sum = sum + x[i] * x[i];
  return sum;
}

// --- rotations -------------------------------------------------------------------------------------------------------

template <int N, int Rows, int Columns = 0>
struct OfVector {  // of one vector
  static constexpr int kInputs = 1, kRequired = 1, kNumbers = N, kOutputs = Columns ? Rows * Columns : Rows, kPlain = 0,
                       kCut = 0;
  static constexpr Extent extent(int) { return {N}; }
  static constexpr Extent result = {Rows, Columns};
};

// O. Rodrigues (1840): cos + (1 - cos) a a^T + sin [a].
template <class V>
KV_HD void rotation_of(V const* v, V* m) {
  V sinc, cosine;
  sinc_cos(squared(v, 3) * .25, sinc, cosine);
  V const versine = sinc * sinc * .5, sine = sinc * cosine;  // (1 - cos) / angle^2, sin / angle
  V const xx = v[0] * v[0] * versine, yy = v[1] * v[1] * versine, zz = v[2] * v[2] * versine;
  V const xy = v[0] * v[1] * versine, yz = v[1] * v[2] * versine, zx = v[2] * v[0] * versine;
  V const x = v[0] * sine, y = v[1] * sine, z = v[2] * sine;
  m[0] = 1. - yy - zz, m[1] = xy - z, m[2] = zx + y;
  m[3] = xy + z, m[4] = 1. - zz - xx, m[5] = yz - x;
  m[6] = zx - y, m[7] = yz + x, m[8] = 1. - xx - yy;
}

struct AxisAngleToRotationMatrix : OfVector<3, 3, 3> {
  template <class V>
  static KV_HD void of(V const* v, V* m, Settings const&) {
    rotation_of(v, m);
  }
};

// The quaternion that turns by twice `part` times the length of a vector.
struct QuaternionExponential : OfVector<3, 4> {
  static constexpr int kPlain = 1;
  template <class V>
  static KV_HD void of(V const* v, V* q, Settings const& s) {
    double const part = s.number[0];
    V sinc;
    sinc_cos(squared(v, 3) * (part * part), sinc, q[0]);
    for (int i = 0; i < 3; ++i) q[1 + i] = v[i] * part * sinc;
  }
};

template <class V>
KV_HD void axis_angle_of(V const* q, V* v, double tiny) {
  auto const other = q[0] < 0.;  // q and -q are one rotation
  V const part = angle_per_sine(squared(q + 1, 3), select(other, -q[0], q[0]), tiny) * 2.;
  V const factor = select(other, -part, part);
  for (int i = 0; i < 3; ++i) v[i] = q[1 + i] * factor;
}

struct QuaternionToAxisAngle : OfVector<4, 3> {
  template <class V>
  static KV_HD void of(V const* q, V* v, Settings const& s) {
    axis_angle_of(q, v, s.tiny);
  }
};

struct QuaternionLogarithm : OfVector<4, 3> {
  template <class V>
  static KV_HD void of(V const* q, V* v, Settings const& s) {
    V const factor = angle_per_sine(squared(q + 1, 3), q[0], s.tiny);
    for (int i = 0; i < 3; ++i) v[i] = q[1 + i] * factor;
  }
};

struct NormalizeQuaternion : OfVector<4, 4> {
  static constexpr int kPlain = 1;
  template <class V>
  static KV_HD void of(V const* q, V* unit, Settings const& s) {
    double const least = s.number[0];
    V const square = squared(q, 4);
    V const length = select(square <= least * least, number<V>(least), square_root(square));
    for (int i = 0; i < 4; ++i) unit[i] = q[i] / length;
  }
};

struct QuaternionToRotationMatrix : OfVector<4, 3, 3> {
  template <class V>
  static KV_HD void of(V const* q, V* m, Settings const& s) {
    V const square = squared(q, 4), twice = select(square < s.tiny, number<V>(0), number<V>(2) / square);
    V const &x = q[1], &y = q[2], &z = q[3];
    V const w2 = q[0] * twice, x2 = x * twice, y2 = y * twice, z2 = z * twice;
    m[0] = 1. - y2 * y - z2 * z, m[1] = x2 * y - w2 * z, m[2] = x2 * z + w2 * y;
    m[3] = x2 * y + w2 * z, m[4] = 1. - x2 * x - z2 * z, m[5] = y2 * z - w2 * x;
    m[6] = x2 * z - w2 * y, m[7] = y2 * z + w2 * x, m[8] = 1. - x2 * x - y2 * y;
  }
};

struct QuaternionProduct {
  static constexpr int kInputs = 2, kRequired = 2, kNumbers = 8, kOutputs = 4, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {4}; }
  static constexpr Extent result = {4};
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    V const *const p = x, *const q = x + 4;
    y[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3];
    y[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2];
    y[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1];
    y[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0];
  }
};

// From the largest of its components: every row below is the quaternion times 4 of one of them (S. W. Shepperd, 1978).
template <class V>
KV_HD void quaternion_of(V const* m, V* q) {
  V const &a = m[0], &e = m[4], &i = m[8];
  V const x = m[7] - m[5], y = m[2] - m[6], z = m[3] - m[1];
  V const xy = m[1] + m[3], zx = m[2] + m[6], yz = m[5] + m[7];
  auto const by_w = a + e + i > 0., x_over_y = a >= e, x_over_z = a >= i, y_over_z = e >= i;
  V const w_row[] = {1. + a + e + i, x, y, z}, x_row[] = {x, 1. + a - e - i, xy, zx};
  V const y_row[] = {y, xy, 1. - a + e - i, yz}, z_row[] = {z, zx, yz, 1. - a - e + i};
  V row[4];
  for (int k = 0; k < 4; ++k) {
    V const with_x = select(x_over_z, x_row[k], z_row[k]), with_y = select(y_over_z, y_row[k], z_row[k]);
    row[k] = select(by_w, w_row[k], select(x_over_y, with_x, with_y));
  }
  V const largest_xyz = select(x_over_y, select(x_over_z, row[1], row[3]), select(y_over_z, row[2], row[3]));
  V const twice = square_root(select(by_w, row[0], largest_xyz)) * 2.;
  for (int k = 0; k < 4; ++k) q[k] = row[k] / twice;
}

struct RotationMatrixToQuaternion : OfVector<9, 4> {
  static constexpr Extent extent(int) { return {3, 3}; }
  template <class V>
  static KV_HD void of(V const* m, V* q, Settings const&) {
    quaternion_of(m, q);
  }
};

struct CrossMatrix : OfVector<3, 3, 3> {
  template <class V>
  static KV_HD void of(V const* v, V* m, Settings const&) {
    m[0] = m[4] = m[8] = number<V>(0);
    m[1] = -v[2], m[2] = v[1], m[3] = v[2], m[5] = -v[0], m[6] = -v[1], m[7] = v[0];
  }
};

struct RotationMatrixToAxisAngle : OfVector<9, 3> {
  static constexpr Extent extent(int) { return {3, 3}; }
  template <class V>
  static KV_HD void of(V const* m, V* v, Settings const& s) {
    V q[4];
    quaternion_of(m, q);
    axis_angle_of(q, v, s.tiny);
  }
};

template <int N>
struct OfNumbers {  // of N numbers, tensors of their own
  static constexpr int kInputs = N, kRequired = N, kNumbers = N, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {}; }
};

struct AngleToRotationMatrix : OfNumbers<1> {
  static constexpr int kOutputs = 4;
  static constexpr Extent result = {2, 2};
  template <class V>
  static KV_HD void of(V const* degrees, V* m, Settings const&) {
    of_degrees(degrees[0], m[0], m[1]);
    m[2] = -m[1] + 0., m[3] = m[0];
  }
};

struct QuaternionFromEuler : OfNumbers<3> {
  static constexpr int kOutputs = 4;
  static constexpr Extent result = {4};
  template <class V>
  static KV_HD void of(V const* angles, V* q, Settings const&) {
    V s[3], c[3];
    for (int i = 0; i < 3; ++i) sin_cos(angles[i] * .5, s[i], c[i]);
    q[0] = c[0] * c[1] * c[2] + s[0] * s[1] * s[2];
    q[1] = s[0] * c[1] * c[2] - c[0] * s[1] * s[2];
    q[2] = c[0] * s[1] * c[2] + s[0] * c[1] * s[2];
    q[3] = c[0] * c[1] * s[2] - s[0] * s[1] * c[2];
  }
  // Along roll the derivative is q i / 2, along yaw k q / 2.
  template <class V>
  static KV_HD void pull(V const* angles, V const* g, V* to, Settings const& settings) {
    V s[3], c[3], q[4];
    of(angles, q, settings);
    for (int i = 0; i < 3; ++i) sin_cos(angles[i] * .5, s[i], c[i]);
    to[0] = (q[0] * g[1] - q[1] * g[0] + q[3] * g[2] - q[2] * g[3]) * .5;
    to[2] = (q[0] * g[3] - q[3] * g[0] + q[1] * g[2] - q[2] * g[1]) * .5;
    to[1] = (s[0] * c[1] * s[2] - c[0] * s[1] * c[2]) * g[0] - (s[0] * s[1] * c[2] + c[0] * c[1] * s[2]) * g[1];
    to[1] = to[1] + (c[0] * c[1] * c[2] - s[0] * s[1] * s[2]) * g[2];
    to[1] = (to[1] - (c[0] * s[1] * s[2] + s[0] * c[1] * c[2]) * g[3]) * .5;
  }
};

// E. Bernardes, S. Viollet (2022): (yaw + roll) / 2 is the angle of (a, b), (yaw - roll) / 2 that of (c, d).
struct EulerFromQuaternion : OfNumbers<4> {
  static constexpr int kOutputs = 3;
  static constexpr Extent result = {3};
  template <class V>
  static KV_HD V within_pi(V const& angle) {
    constexpr double turn = 6.28318530717958647693;
    return subtract_constant(angle, rounded(angle * (1 / turn)) * turn);
  }
  template <class V>
  static KV_HD void of(V const* q, V* euler, Settings const& s) {
    V const zero = number<V>(0);
    V const a = q[0] - q[2], b = q[1] + q[3], c = q[0] + q[2], d = q[3] - q[1];
    V const p = a * a + b * b, m = c * c + d * d, least = (p + m) * (16 * s.eps * s.eps);
    auto const up = p <= least, down = m <= least;  // both for the quaternion 0
    V const first = select(up, zero, arctan2(b, a)), second = select(down, zero, arctan2(d, c));
    V const total = select(up, select(down, first, second), first), difference = select(down, total, second);
    V const half_pi = number<V>(1.57079632679489661923);
    V const between = arctan2(square_root(m), square_root(p)) * 2. - half_pi;
    V const at_pole = select(up, select(down, zero, half_pi), -half_pi);
    euler[0] = within_pi(total - difference);
    euler[1] = select(up, at_pole, select(down, at_pole, between));
    euler[2] = within_pi(total + difference);
  }
};

// --- rigid transformations of space, (4, 4) whose last rows are taken for 0 0 0 1 ------------------------------------

template <int N>
struct OfPoses {
  static constexpr int kInputs = N, kRequired = N, kNumbers = 16 * N, kOutputs = 16, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {4, 4}; }
  static constexpr Extent result = {4, 4};
};

template <class V>
KV_HD void write_last_row(V* m, double last) {
  for (int i = 12; i < 16; ++i) m[i] = number<V>(i == 15 ? last : 0);
}

// c = R b and c = R^T b, of R, the rotation of pose a, and three rows of four.
template <class V>
KV_HD void turn(V const* a, V const* b, V* c) {
  for (int i = 0; i < 12; ++i) {
    V const* const row = a + i / 4 * 4;
    c[i] = row[0] * b[i % 4] + row[1] * b[4 + i % 4] + row[2] * b[8 + i % 4];
  }
}
template <class V>
KV_HD void turn_back(V const* a, V const* b, V* c) {
  for (int i = 0; i < 12; ++i) {
    V const* const column = a + i / 4;
    c[i] = column[0] * b[i % 4] + column[4] * b[4 + i % 4] + column[8] * b[8 + i % 4];
  }
}

// R1 R2, R1 t2 + t1.
struct ComposePoses : OfPoses<2> {
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    turn(x, x + 16, m);
    for (int i = 3; i < 12; i += 4) m[i] = m[i] + x[i];
    write_last_row(m, 1);
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    for (int i = 0; i < 12; ++i) {
      V const *const a = g + i / 4 * 4, *const b = x + 16 + i % 4 * 4;
      to[i] = i % 4 == 3 ? g[i] : a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    }
    turn_back(x, g, to + 16);
    write_last_row(to, 0);
    write_last_row(to + 16, 0);
  }
};

// R^T, -R^T t.
struct InvertPose : OfPoses<1> {
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) m[4 * i + k] = x[4 * k + i];
      m[4 * i + 3] = -(x[i] * x[3] + x[4 + i] * x[7] + x[8 + i] * x[11]);
    }
    write_last_row(m, 1);
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    for (int i = 0; i < 3; ++i) {
      V const *const row = x + 4 * i, t = row[3];
      for (int k = 0; k < 3; ++k) to[4 * i + k] = g[4 * k + i] - t * g[4 * k + 3];
      to[4 * i + 3] = -(row[0] * g[3] + row[1] * g[7] + row[2] * g[11]);
    }
    write_last_row(to, 0);
  }
};

// R1^T R2, R1^T (t2 - t1).
struct RelativePose : OfPoses<2> {
  template <class V>
  static KV_HD void between(V const* x, V* s) {
    for (int i = 0; i < 12; ++i) s[i] = i % 4 == 3 ? x[16 + i] - x[i] : x[16 + i];
  }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    V s[12];
    between(x, s);
    turn_back(x, s, m);
    write_last_row(m, 1);
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    V s[12];
    between(x, s);
    turn(x, g, to + 16);
    for (int i = 0; i < 12; ++i) {
      V const *const a = s + i / 4 * 4, *const b = g + i % 4 * 4;
      to[i] = i % 4 == 3 ? -to[16 + i] : a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    }
    write_last_row(to, 0);
    write_last_row(to + 16, 0);
  }
};

// --- matrices of images ----------------------------------------------------------------------------------------------

// The affine map of n dimensions whose linear part is `linear` about `center`, moved: n + 1 rows of n + 1 numbers.
template <int n, class V>
KV_HD void write_affine(V const* linear, V const* center, V const* moved, V* m) {
  for (int i = 0; i < n; ++i) {
    V at = center[i];
    if (moved) at = at + moved[i];
    for (int k = 0; k < n; ++k) {
      at = at - linear[n * i + k] * center[k];
      m[(n + 1) * i + k] = linear[n * i + k] + 0.;  // no negative zeros
    }
    m[(n + 1) * i + n] = at + 0.;
  }
  for (int k = 0; k <= n; ++k) m[(n + 1) * n + k] = number<V>(k == n);
}

// An angle in degrees, translation, scale, shear angles along x and y, center (its plain numbers where there is none):
// shear, scale and turn about the center, then move.
struct AffineMatrix2d {
  static constexpr int kInputs = 6, kRequired = 1, kNumbers = 9, kOutputs = 9, kPlain = 3, kCut = 1;
  static constexpr Extent extent(int i) { return {i == 1 || i == 2 || i == 5 ? 2 : 0}; }
  static constexpr Extent result = {3, 3};
  static KV_HD double missing(int i, Settings const& s) { return i >= 7 ? s.number[i - 6] : i == 3 || i == 4; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const& settings) {
    V c, s;
    of_degrees(x[0] * settings.number[0], c, s);
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

// A translation, 0 if not given, and numbers that are added to it.
template <int n>
struct TranslationMatrix : OfVector<n, n + 1, n + 1> {
  static constexpr int kRequired = 0, kPlain = n, kCut = 1;
  static KV_HD double missing(int, Settings const&) { return 0; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const& s) {
    for (int i = 0; i < (n + 1) * (n + 1); ++i) m[i] = number<V>(i % (n + 2) == 0);
    for (int i = 0; i < n; ++i) m[(n + 1) * i + n] = x[i] + s.number[i];
  }
};
using TranslationMatrix2d = TranslationMatrix<2>;
using TranslationMatrix3d = TranslationMatrix<3>;

// Scales and a center (its plain numbers where there is none).
struct ScaleMatrix2d {
  static constexpr int kInputs = 2, kRequired = 1, kNumbers = 4, kOutputs = 6, kPlain = 2, kCut = 0;
  static constexpr Extent extent(int) { return {2}; }
  static constexpr Extent result = {2, 3};
  static KV_HD double missing(int i, Settings const& s) { return s.number[i - 2]; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    for (int i = 0; i < 6; ++i) m[i] = number<V>(0);
    m[0] = x[0], m[4] = x[1];
    m[2] = x[2] - x[0] * x[2] + 0., m[5] = x[3] - x[1] * x[3] + 0.;
  }
};

// A center, and angles of shears along x, then y.
struct ShearMatrix2d {
  static constexpr int kInputs = 3, kRequired = 1, kNumbers = 4, kOutputs = 9, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int i) { return {i == 0 ? 2 : 0}; }
  static constexpr Extent result = {3, 3};
  static KV_HD double missing(int, Settings const&) { return 0; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    V const a = tangent(x[2]), b = tangent(x[3]);
    V const linear[] = {number<V>(1), -a, -b, 1. + a * b};
    write_affine<2>(linear, x, static_cast<V const*>(nullptr), m);
  }
};

struct SlantMatrix2d : OfVector<2, 2, 3> {
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    for (int i = 0; i < 6; ++i) m[i] = number<V>(i % 4 == 0);
    m[1] = x[0], m[3] = x[1];
  }
};

struct InvertAffine2d : OfVector<6, 2, 3> {
  static constexpr Extent extent(int) { return {2, 3}; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    V const determinant = x[0] * x[4] - x[1] * x[3];
    m[0] = x[4] / determinant + 0., m[1] = -x[1] / determinant + 0.;
    m[3] = -x[3] / determinant + 0., m[4] = x[0] / determinant + 0.;
    m[2] = (x[1] * x[5] - x[4] * x[2]) / determinant + 0.;
    m[5] = (x[3] * x[2] - x[0] * x[5]) / determinant + 0.;
  }
};

// Three numbers of an axis times an angle in degrees, translation, scale, center (plain numbers where there is none),
// six shear angles.
template <class V>
KV_HD void shear_in_space(V const* angles, V* m) {
  V t[6];
  for (int i = 0; i < 6; ++i) t[i] = -tangent(angles[i]);
  V const &xy = t[0], &xz = t[1], &yx = t[2], &yz = t[3], &zx = t[4], &zy = t[5];
  m[0] = number<V>(1), m[1] = yx, m[2] = zx + yx * zy;
  m[3] = xy, m[4] = xy * m[1] + 1., m[5] = xy * m[2] + zy;
  m[6] = xz, m[7] = xz * m[1] + yz, m[8] = xz * m[2] + yz * zy + 1.;
}

struct AffineMatrix3d {
  static constexpr int kInputs = 12, kRequired = 3, kNumbers = 18, kOutputs = 16, kPlain = 4, kCut = 1;
  static constexpr Extent extent(int i) { return {i >= 3 && i < 6 ? 3 : 0}; }
  static constexpr Extent result = {4, 4};
  static KV_HD double missing(int i, Settings const& s) { return i >= 9 && i < 12 ? s.number[i - 8] : i >= 6 && i < 9; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const& s) {
    V v[3], turn[9], shear[9], linear[9];
    for (int i = 0; i < 3; ++i) v[i] = x[i] * (s.number[0] * 0.017453292519943295769);
    rotation_of(v, turn);
    shear_in_space(x + 12, shear);
    for (int i = 0; i < 9; ++i) turn[i] = turn[i] * x[6 + i % 3];
    for (int i = 0; i < 9; ++i) {
      int const row = i / 3 * 3, k = i % 3;
      linear[i] = turn[row] * shear[k] + turn[row + 1] * shear[3 + k] + turn[row + 2] * shear[6 + k];
    }
    write_affine<3>(linear, x + 9, x + 3, m);
  }
};

struct ShearMatrix3d {
  static constexpr int kInputs = 7, kRequired = 1, kNumbers = 9, kOutputs = 16, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int i) { return {i == 0 ? 3 : 0}; }
  static constexpr Extent result = {4, 4};
  static KV_HD double missing(int, Settings const&) { return 0; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    V linear[9];
    shear_in_space(x + 3, linear);
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
  // Of a box without area all three are 0; it goes on as a parallelogram does.
  V const other = select(s[0] == 0., select(s[1] == 0., number<V>(1), area), area), w = select(area == 0., other, area);
  for (int i = 0; i < 2; ++i) {
    m[3 * i] = w * (p[2 + i] - p[i]) + g * p[2 + i];
    m[3 * i + 1] = w * (p[6 + i] - p[i]) + h * p[6 + i];
    m[3 * i + 2] = w * p[i];
  }
  m[6] = g, m[7] = h, m[8] = w;
}

struct PerspectiveMatrix {
  static constexpr int kInputs = 2, kRequired = 2, kNumbers = 16, kOutputs = 9, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {4, 2}; }
  static constexpr Extent result = {3, 3};
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const&) {
    V from[9], to[9], back[9];
    from_unit_square(x, from);
    from_unit_square(x + 8, to);
    for (int i = 0; i < 9; ++i) {  // the adjugate
      int const r = i % 3, c = i / 3, r1 = (r + 1) % 3, r2 = (r + 2) % 3, c1 = (c + 1) % 3, c2 = (c + 2) % 3;
      back[i] = from[3 * r1 + c1] * from[3 * r2 + c2] - from[3 * r1 + c2] * from[3 * r2 + c1];
    }
    for (int i = 0; i < 9; ++i) {
      int const row = i / 3 * 3, k = i % 3;
      m[i] = to[row] * back[k] + to[row + 1] * back[3 + k] + to[row + 2] * back[6 + k];
    }
    V const last = m[8];
    for (int i = 0; i < 9; ++i) m[i] = m[i] / last + 0.;
  }
};

// From pixels of a result to those of the quadrangles they show, which go to a rectangle of the result: where that
// begins (0, 0 if not given), and how far it is from its first pixels to its last ones, or 1.
struct CropMatrix {
  static constexpr int kInputs = 2, kRequired = 1, kNumbers = 10, kOutputs = 9, kPlain = 2, kCut = 0;
  static constexpr Extent extent(int i) { return i == 0 ? Extent{4, 2} : Extent{2}; }
  static constexpr Extent result = {3, 3};
  static KV_HD double missing(int, Settings const&) { return 0; }
  template <class V>
  static KV_HD void of(V const* x, V* m, Settings const& s) {
    from_unit_square(x, m);
    V const scale = select(m[8] == 0., number<V>(1), m[8]);
    for (int i = 0; i < 9; ++i) m[i] = m[i] / scale;  // exact for whole boxes
    for (int i = 0; i < 3; ++i) {
      V* const row = m + 3 * i;
      row[0] = row[0] / number<V>(s.number[0]), row[1] = row[1] / number<V>(s.number[1]);
      row[2] = row[2] - row[0] * x[8] - row[1] * x[9];
    }
  }
};

// The homography of space that takes five points, no four of them in a plane, to others: the corners 0, 1, 2, 5 and 7
// of boxes. Of the first four, p_i, it makes q_i, by factors that are the volumes which the fifth one spans with the
// other three, there and here; row i of the inverse of the matrix of p_i is the plane through these. The others, if not
// given, are the corners of the box from 0 to three plain numbers.
struct PerspectiveMatrix3d {
  static constexpr int kInputs = 2, kRequired = 1, kNumbers = 48, kOutputs = 16, kPlain = 3, kCut = 0;
  static constexpr Extent extent(int) { return {8, 3}; }
  static constexpr Extent result = {4, 4};
  static KV_HD double missing(int i, Settings const& s) {
    int const point = i / 3 % 8, axis = i % 3;
    bool const far = axis == 2 ? point >= 4 : axis == 1 ? point % 4 >= 2 : point % 4 == 1 || point % 4 == 2;
    return far ? s.number[axis] : 0;
  }

  static KV_HD int corner(int i) { return i < 3 ? i : 2 * i - 1; }
  // The plane through the first four points but point i, and its value at the fifth.
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
  static KV_HD void of(V const* x, V* m, Settings const&) {
    for (int i = 0; i < 16; ++i) m[i] = number<V>(0);
    for (int i = 0; i < 4; ++i) {
      V here[4], there[4];
      V const from = plane(x, i, here), factor = plane(x + 24, i, there) / from, *const q = x + 24 + 3 * corner(i);
      for (int k = 0; k < 4; ++k) {
        V const part = factor * here[k];
        for (int row = 0; row < 3; ++row) m[4 * row + k] = m[4 * row + k] + q[row] * part;
        m[12 + k] = m[12 + k] + part;
      }
    }
    V const last = m[15];
    for (int i = 0; i < 16; ++i) m[i] = m[i] / last;
  }
};

// Of two quadrangles: what their opposite sides differ by, x and y of each, and the way from the second one's first
// corner to its third.
struct QuadShapes {
  static constexpr int kInputs = 2, kRequired = 2, kNumbers = 16, kOutputs = 6, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {4, 2}; }
  static constexpr Extent result = {6};
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    for (int i = 0; i < 4; ++i) {
      V const* const p = x + i / 2 * 8 + i % 2;
      y[i] = p[2] - p[0] - p[4] + p[6];
    }
    for (int i = 0; i < 2; ++i) y[4 + i] = x[12 + i] - x[8 + i];
  }
};

// --- two views of one scene ------------------------------------------------------------------------------------------

// c = a b of 3 x 3 matrices, either of them transposed.
template <bool kTransposeA, bool kTransposeB, class V>
KV_HD void product3(V const* a, V const* b, V* c) {
  for (int i = 0; i < 9; ++i) {
    V const *const row = a + (kTransposeA ? i / 3 : i / 3 * 3), *const column = b + (kTransposeB ? i % 3 * 3 : i % 3);
    constexpr int along = kTransposeA ? 3 : 1, down = kTransposeB ? 1 : 3;
    c[i] = row[0] * column[0] + row[along] * column[down] + row[2 * along] * column[2 * down];
  }
}
template <class V>
KV_HD void cross3(V const* a, V const* b, V* c) {
  for (int i = 0; i < 3; ++i) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

// y = right^T m left, and from its gradient to all three.
template <class V>
KV_HD void between(V const* m, V const* left, V const* right, V* y) {
  V half[9];
  product3<false, false>(m, left, half);
  product3<true, false>(right, half, y);
}
template <class V>
KV_HD void between_vjp(V const* m, V const* left, V const* right, V const* g, V* to_m, V* to_left, V* to_right) {
  V half[9];
  product3<false, false>(m, left, half);
  product3<false, true>(half, g, to_right);
  product3<false, false>(right, g, half);
  product3<false, true>(half, left, to_m);
  product3<true, false>(m, half, to_left);
}

// NaN where there is none.
template <class V>
KV_HD void inverse3(V const* m, V* inverse) {
  V columns[9];
  for (int i = 0; i < 3; ++i) cross3(m + (i + 1) % 3 * 3, m + (i + 2) % 3 * 3, columns + 3 * i);
  V const volume = m[0] * columns[0] + m[1] * columns[1] + m[2] * columns[2];
  V const factor = select(volume == 0., number<V>(__builtin_nan("")), 1. / volume);
  for (int i = 0; i < 9; ++i) inverse[i] = columns[i % 3 * 3 + i / 3] * factor;
}

// A matrix and two cameras.
struct OfCameras {
  static constexpr int kInputs = 3, kRequired = 3, kNumbers = 27, kOutputs = 9, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {3, 3}; }
  static constexpr Extent result = {3, 3};
};

struct EssentialFromFundamental : OfCameras {
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    between(x, x + 9, x + 18, y);
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    between_vjp(x, x + 9, x + 18, g, to, to + 9, to + 18);
  }
};

struct FundamentalFromEssential : OfCameras {
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    V left[9], right[9];
    inverse3(x + 9, left);
    inverse3(x + 18, right);
    between(x, left, right, y);
  }
  // The gradient to K is -K^-T (that to K^-1) K^-T.
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    V inverses[18], slopes[18], half[9];
    inverse3(x + 9, inverses);
    inverse3(x + 18, inverses + 9);
    between_vjp(x, inverses, inverses + 9, g, to, slopes, slopes + 9);
    for (int i = 0; i < 18; i += 9) {
      product3<true, false>(inverses + i, slopes + i, half);
      product3<false, true>(half, inverses + i, to + 9 + i);
      for (int k = 0; k < 9; ++k) to[9 + i + k] = -to[9 + i + k];
    }
  }
};

// Rotations and translations of two cameras.
struct OfMotions {
  static constexpr int kInputs = 4, kRequired = 4, kNumbers = 24, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int i) { return {3, i % 2 ? 1 : 3}; }

  // R = R2 R1^T and t = t2 - R t1.
  template <class V>
  static KV_HD void motion(V const* x, V* R, V* t) {
    product3<false, true>(x + 12, x, R);
    for (int i = 0; i < 3; ++i) t[i] = x[21 + i] - (R[3 * i] * x[9] + R[3 * i + 1] * x[10] + R[3 * i + 2] * x[11]);
  }
  template <class V>
  static KV_HD void motion_vjp(V const* x, V const* R, V const* to_R, V const* to_t, V* to) {
    V g[9];
    for (int i = 0; i < 9; ++i) g[i] = to_R[i] - to_t[i / 3] * x[9 + i % 3];
    product3<true, false>(g, x + 12, to);
    product3<false, false>(g, x, to + 12);
    for (int i = 0; i < 3; ++i) {
      to[9 + i] = -(R[i] * to_t[0] + R[3 + i] * to_t[1] + R[6 + i] * to_t[2]);
      to[21 + i] = to_t[i];
    }
  }
};

// R's rows, then t.
struct CameraMotion : OfMotions {
  static constexpr int kOutputs = 12;
  static constexpr Extent result = {4, 3};
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    motion(x, y, y + 9);
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    V R[9], t[3];
    motion(x, R, t);
    motion_vjp(x, R, g, g + 9, to);
  }
};

// [t]x R.
struct EssentialFromMotions : OfMotions {
  static constexpr int kOutputs = 9;
  static constexpr Extent result = {3, 3};
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    V R[9], t[3];
    motion(x, R, t);
    for (int i = 0; i < 9; ++i) {
      int const after = (i / 3 + 1) % 3, last = (i / 3 + 2) % 3;
      y[i] = t[after] * R[3 * last + i % 3] - t[last] * R[3 * after + i % 3];
    }
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    V R[9], t[3], to_R[9], to_t[3];
    motion(x, R, t);
    for (int i = 0; i < 3; ++i) {
      V const *const R1 = R + (i + 1) % 3 * 3, *const R2 = R + (i + 2) % 3 * 3, *const g1 = g + (i + 1) % 3 * 3,
                     *const g2 = g + (i + 2) % 3 * 3;
      to_t[i] = number<V>(0);
      for (int k = 0; k < 3; ++k) {
        to_t[i] = to_t[i] + (R1[k] * g2[k] - R2[k] * g1[k]);
        to_R[3 * i + k] = g1[k] * t[(i + 2) % 3] - g2[k] * t[(i + 1) % 3];
      }
    }
    motion_vjp(x, R, to_R, to_t, to);
  }
};

// The determinant of four rows of two projections, for each pair of rows that is left out of both: for each pair of
// columns that of the first one's rows, times that of the second one's for the other columns.
struct FundamentalFromProjections {
  static constexpr int kInputs = 2, kRequired = 2, kNumbers = 24, kOutputs = 9, kPlain = 0, kCut = 0;
  static constexpr Extent extent(int) { return {3, 4}; }
  static constexpr Extent result = {3, 3};

  // Columns of pair `i` of projection `which`: those of 0 ascend, those of 1 are the others.
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
  static KV_HD void minors_vjp(V const* p, int which, V const* g, V* to) {
    for (int i = 0; i < 12; ++i) to[i] = number<V>(0);
    for (int r = 0; r < 3; ++r) {
      int const first = (r + 1) % 3 * 4, second = (r + 2) % 3 * 4;
      for (int i = 0; i < 6; ++i) {
        int const c = column(which, i, 0), d = column(which, i, 1);
        V const& slope = g[6 * r + i];
        to[first + c] = to[first + c] + slope * p[second + d], to[first + d] = to[first + d] - slope * p[second + c];
        to[second + d] = to[second + d] + slope * p[first + c], to[second + c] = to[second + c] - slope * p[first + d];
      }
    }
  }
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    V one[18], two[18];
    minors(x, 0, one);
    minors(x + 12, 1, two);
    for (int i = 0; i < 9; ++i) {
      y[i] = number<V>(0);
      for (int k = 0; k < 6; ++k) y[i] = y[i] + two[i / 3 * 6 + k] * one[i % 3 * 6 + k];
    }
  }
  template <class V>
  static KV_HD void pull(V const* x, V const* g, V* to, Settings const&) {
    V one[18], two[18], to_one[18], to_two[18];
    minors(x, 0, one);
    minors(x + 12, 1, two);
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 6; ++k) {
        to_one[6 * r + k] = g[r] * two[k] + g[3 + r] * two[6 + k] + g[6 + r] * two[12 + k];
        to_two[6 * r + k] = g[3 * r] * one[k] + g[3 * r + 1] * one[6 + k] + g[3 * r + 2] * one[12 + k];
      }
    minors_vjp(x, 0, to_one, to);
    minors_vjp(x + 12, 1, to_two, to + 12);
  }
};

// A projection K [R | t] as the rows of K, upper triangular, those of R, and t: the rows of its first three columns are
// made orthogonal, the last one first.
struct CameraOfProjection : OfVector<12, 7, 3> {
  static constexpr Extent extent(int) { return {3, 4}; }

  template <class V>
  static KV_HD V dot(V const* a, V const* b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  }
  // Of x less a and b times two others: its length, and it over that.
  template <class V>
  static KV_HD V unit(V const* x, V const& a, V const* one, V const& b, V const* two, V* found) {
    for (int i = 0; i < 3; ++i) found[i] = x[i] - a * one[i] - b * two[i];
    V const size = square_root(dot(found, found));
    for (int i = 0; i < 3; ++i) found[i] = found[i] / size;
    return size;
  }
  template <class V>
  static KV_HD void of(V const* x, V* y, Settings const&) {
    V const *const a = x, *const b = x + 4, *const c = x + 8, zero = number<V>(0);
    V first[3], second[3], third[3], across[3];
    V const f = unit(c, zero, c, zero, c, third), e = dot(b, third), d = unit(b, e, third, zero, third, second);
    V const m = dot(a, second), n = dot(a, third), h = unit(a, m, second, n, third, first);
    cross3(first, second, across);
    V const turn = select(dot(across, third) < 0., number<V>(-1), number<V>(1));
    V const K[] = {h, m, n, zero, d, e, zero, zero, f};
    for (int i = 0; i < 9; ++i) y[i] = K[i];
    for (int i = 0; i < 3; ++i) y[9 + i] = first[i] * turn, y[12 + i] = second[i] * turn, y[15 + i] = third[i] * turn;
    y[20] = c[3] * turn / f;
    y[19] = (b[3] * turn - e * y[20]) / d;
    y[18] = (a[3] * turn - m * y[19] - n * y[20]) / h;
  }
};

// --- the operators: name, formula, arguments -------------------------------------------------------------------------

// Those that warps of images know, and those of volumes.
#define KV_PLANE_FORMULAS(_)                                                                                 \
  _(affine_matrix2d, AffineMatrix2d,                                                                         \
    "Tensor degrees, Tensor? translation, Tensor? scale, Tensor? shear_x, Tensor? shear_y, Tensor? center, " \
    "float turn, float x, float y, int rows")                                                                \
  _(translation_matrix2d, TranslationMatrix2d, "Tensor translation, float x, float y, int rows")             \
  _(scale_matrix2d, ScaleMatrix2d, "Tensor scale, Tensor? center, float x, float y")                         \
  _(slant_matrix2d, SlantMatrix2d, "Tensor slant")                                                           \
  _(crop_matrix, CropMatrix, "Tensor quads, Tensor? first, float across, float down")

#define KV_SPACE_FORMULAS(_)                                                                                       \
  _(affine_matrix3d, AffineMatrix3d,                                                                               \
    "Tensor x, Tensor y, Tensor z, Tensor? translation, Tensor? scale, Tensor? center, Tensor? xy, Tensor? xz, "   \
    "Tensor? yx, Tensor? yz, Tensor? zx, Tensor? zy, float turn, float center_x, float center_y, float center_z, " \
    "int rows")                                                                                                    \
  _(translation_matrix3d, TranslationMatrix3d, "Tensor translation, float x, float y, float z, int rows")          \
  _(perspective_matrix3d, PerspectiveMatrix3d, "Tensor points_src, Tensor? points_dst, float x, float y, float z")

#define KV_FORMULAS(_)                                                                                           \
  _(axis_angle_to_rotation_matrix, AxisAngleToRotationMatrix, "Tensor axis_angle")                               \
  _(quaternion_exponential, QuaternionExponential, "Tensor vector, float part")                                  \
  _(quaternion_to_axis_angle, QuaternionToAxisAngle, "Tensor quaternion")                                        \
  _(quaternion_logarithm, QuaternionLogarithm, "Tensor quaternion")                                              \
  _(quaternion_product, QuaternionProduct, "Tensor left, Tensor right")                                          \
  _(normalize_quaternion, NormalizeQuaternion, "Tensor quaternion, float eps")                                   \
  _(quaternion_to_rotation_matrix, QuaternionToRotationMatrix, "Tensor quaternion")                              \
  _(rotation_matrix_to_quaternion, RotationMatrixToQuaternion, "Tensor matrix")                                  \
  _(cross_matrix, CrossMatrix, "Tensor vector")                                                                  \
  _(compose_poses, ComposePoses, "Tensor first, Tensor second")                                                  \
  _(invert_pose, InvertPose, "Tensor pose")                                                                      \
  _(relative_pose, RelativePose, "Tensor first, Tensor second")                                                  \
  _(rotation_matrix_to_axis_angle, RotationMatrixToAxisAngle, "Tensor matrix")                                   \
  _(angle_to_rotation_matrix, AngleToRotationMatrix, "Tensor degrees")                                           \
  _(quaternion_from_euler, QuaternionFromEuler, "Tensor roll, Tensor pitch, Tensor yaw")                         \
  _(euler_from_quaternion, EulerFromQuaternion, "Tensor w, Tensor x, Tensor y, Tensor z")                        \
  _(shear_matrix2d, ShearMatrix2d, "Tensor center, Tensor? shear_x, Tensor? shear_y")                            \
  _(invert_affine2d, InvertAffine2d, "Tensor matrix")                                                            \
  _(shear_matrix3d, ShearMatrix3d,                                                                               \
    "Tensor center, Tensor? xy, Tensor? xz, Tensor? yx, Tensor? yz, Tensor? zx, Tensor? zy")                     \
  _(perspective_matrix, PerspectiveMatrix, "Tensor points_src, Tensor points_dst")                               \
  _(quad_shapes, QuadShapes, "Tensor quads, Tensor others")                                                      \
  _(essential_from_fundamental, EssentialFromFundamental, "Tensor fundamental, Tensor camera1, Tensor camera2")  \
  _(fundamental_from_essential, FundamentalFromEssential, "Tensor essential, Tensor camera1, Tensor camera2")    \
  _(fundamental_from_projections, FundamentalFromProjections, "Tensor projection1, Tensor projection2")          \
  _(camera_motion, CameraMotion, "Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2") \
  _(essential_from_motions, EssentialFromMotions,                                                                \
    "Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2")                              \
  _(camera_of_projection, CameraOfProjection, "Tensor projection")                                               \
  KV_PLANE_FORMULAS(_)                                                                                           \
  KV_SPACE_FORMULAS(_)

#define KV_NAME_FORMULA(name, Formula, inputs) name,
enum class MatrixBy : int { given, KV_PLANE_FORMULAS(KV_NAME_FORMULA) KV_SPACE_FORMULAS(KV_NAME_FORMULA) };
#undef KV_NAME_FORMULA

#define KV_INSTANTIATE_FORMULA(name, Formula, inputs) \
  KV_INSTANTIATE_ONE(formula, Formulas, Formula)      \
  KV_INSTANTIATE_ONE(formula_backward, Formulas, Formula)

}  // namespace kv
