// Camera poses from samples of four points: of the poses that see three of them, the one that sees the fourth one best.
// kvision's geometry/calibration/p3p.py has the elimination of Grunert that is used here.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"

namespace kv::geometry {

template <class T>
struct SamplePoses {
  Reals points, pixels, camera;  // (B, N, 3), (B, N, 2), (B, 3, 3), upper triangular
  int64_t const* samples;        // (B, S, 4)
  int64_t batch, count, num_samples;
  Reals poses;  // (B, S, 3, 4)
};

KV_KERNEL(sample_poses, SamplePoses)

namespace three_points {

constexpr double kTolerance = 1e-6;  // of the squared sides of a solution, relative to the largest

struct Triangle {
  double X[3][3], rays[3][3];     // rays of length 1
  double squares[3], cosines[3];  // of the sides opposite to each point, and between the rays to their ends
};

KV_HD double largest_square(Triangle const& t) { return max(t.squares[0], max(t.squares[1], t.squares[2])); }

KV_HD void measure(Triangle& t) {
  for (int i = 0; i < 3; ++i) {
    double const length = sqrt(dot3(t.rays[i], t.rays[i]));
    for (double& x : t.rays[i]) x /= length;
  }
  for (int i = 0; i < 3; ++i) {
    int const a = i == 0, b = i == 2 ? 1 : 2;
    double side[3];
    for (int k = 0; k < 3; ++k) side[k] = t.X[a][k] - t.X[b][k];
    t.squares[i] = dot3(side, side);
    t.cosines[i] = dot3(t.rays[a], t.rays[b]);
  }
}

// Whether the points are on one line, or coincide.
KV_HD bool is_flat(Triangle const& t) {
  double side[3], other[3], normal[3];
  for (int k = 0; k < 3; ++k) side[k] = t.X[1][k] - t.X[0][k], other[k] = t.X[2][k] - t.X[0][k];
  cross3(side, other, normal);
  return !(dot3(normal, normal) > 1e-20 * dot3(side, side) * dot3(other, other));
}

// The squared sides between points at distances d, less the given ones; returns the largest difference.
KV_HD double errors_of(Triangle const& t, double const* d, double* e) {
  double largest = 0;
  for (int i = 0; i < 3; ++i) {
    double const a = d[i == 0], b = d[i == 2 ? 1 : 2];
    e[i] = a * a + b * b - 2 * t.cosines[i] * a * b - t.squares[i];
    largest = max(largest, small::magnitude(e[i]));
  }
  return largest;
}

// A step of Newton's method towards the distances whose sides have the given squares. The rows of the matrix are (0,
// p0, q0), (p1, 0, q1) and (p2, q2, 0); Cramer's rule solves it. Singular systems keep what they have.
KV_HD void improve(Triangle const& t, double* d) {
  double p[3], q[3], e[3];
  errors_of(t, d, e);
  for (int i = 0; i < 3; ++i) {
    double const a = d[i == 0], b = d[i == 2 ? 1 : 2];
    p[i] = 2 * (a - t.cosines[i] * b), q[i] = 2 * (b - t.cosines[i] * a);
  }
  double const determinant = p[0] * q[1] * p[2] + q[0] * p[1] * q[2], largest = largest_square(t);
  if (!(small::magnitude(determinant) > 1e-12 * largest * sqrt(largest))) return;
  d[0] -= (p[0] * q[1] * e[2] - q[1] * q[2] * e[0] + q[0] * q[2] * e[1]) / determinant;
  d[1] -= (q[0] * p[1] * e[2] + q[1] * p[2] * e[0] - q[0] * p[2] * e[1]) / determinant;
  d[2] -= (p[1] * q[2] * e[0] + p[0] * p[2] * e[1] - p[0] * p[1] * e[2]) / determinant;
}

KV_HD void multiply(double const* a, int na, double const* b, int nb, double scale, double* to) {
  for (int i = 0; i < na; ++i)
    for (int k = 0; k < nb; ++k) to[i + k] += scale * a[i] * b[k];
}

// Up to four distances of the three points; returns their number.
KV_CALLED int distances(Triangle const& t, double (*found)[3]) {
  double const p = t.squares[0] / t.squares[1], q = t.squares[2] / t.squares[1];
  double const ca = t.cosines[0], cb = t.cosines[1], cc = t.cosines[2];
  double const n[] = {p - q - 1, 2 * (q - p) * cb, 1 + p - q}, m[] = {-2 * ca, 2 * cc};
  double const rest[] = {-q, 2 * q * cb, 1 - q};
  double square[3] = {}, quartic[5] = {}, roots[small::kMaxRoots];
  multiply(m, 2, m, 2, 1, square);
  multiply(square, 3, rest, 3, 1, quartic);
  multiply(n, 3, n, 3, 1, quartic);
  multiply(n, 3, m, 2, -2 * cc, quartic + 1);
  int const num_roots = small::real_roots(quartic, 4, roots);
  int count = 0;
  for (int i = 0; i < num_roots && count < 4; ++i) {
    double const v = roots[i], u = ((n[0] * v + n[1]) * v + n[2]) / (m[0] * v + m[1]);
    double* const d = found[count];
    double e[3];
    d[0] = sqrt(t.squares[1] / (1 + v * v - 2 * v * cb));
    d[1] = u * d[0], d[2] = v * d[0];
    for (int k = 0; k < 2; ++k) improve(t, d);
    bool const is_solution = errors_of(t, d, e) <= kTolerance * largest_square(t);
    if (is_solution && d[0] > 0 && d[1] > 0 && d[2] > 0 && small::finite(d[0] + d[1] + d[2])) ++count;
  }
  for (int i = 0; i < count; ++i) improve(t, found[i]);
  return count;
}

// Orthonormal columns: along the first side of a triangle, one in its plane, and its normal.
KV_HD void frame(double const (*X)[3], double* columns) {
  double first[3], other[3], last[3], middle[3];
  for (int k = 0; k < 3; ++k) first[k] = X[1][k] - X[0][k], other[k] = X[2][k] - X[0][k];
  cross3(first, other, last);
  double const a = sqrt(dot3(first, first)), b = sqrt(dot3(last, last));
  for (int k = 0; k < 3; ++k) first[k] /= a, last[k] /= b;
  cross3(last, first, middle);
  for (int k = 0; k < 3; ++k) columns[3 * k] = first[k], columns[3 * k + 1] = middle[k], columns[3 * k + 2] = last[k];
}

// [R | t] that moves the points to distances d along their rays.
KV_CALLED void pose_of(Triangle const& t, double const* d, double* pose) {
  double Y[3][3], from[9], to[9], R[9];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) Y[i][k] = d[i] * t.rays[i][k];
  frame(t.X, from);
  frame(Y, to);
  multiply3<false, true>(to, from, R);
  double center[3];
  for (int k = 0; k < 3; ++k) center[k] = (t.X[0][k] + t.X[1][k] + t.X[2][k]) / 3;
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 3; ++i) pose[4 * k + i] = R[3 * k + i];
    pose[4 * k + 3] = (Y[0][k] + Y[1][k] + Y[2][k]) / 3 - dot3(R + 3 * k, center);
  }
}

}  // namespace three_points

template <class T>
KV_HD void solve_sample(SamplePoses<T> const& p, int64_t at) {
  using namespace three_points;
  int64_t const b = at / p.num_samples;
  double K[9], X[3], x[2], one[12], found[4][3], pose[12], least = __builtin_inf();
  for (int i = 0; i < 9; ++i) K[i] = p.camera[9 * b + i];
  Triangle t;
  for (int i = 0; i < 4; ++i) {
    int64_t const row = b * p.count + clamp(p.samples[4 * at + i], int64_t(0), p.count - 1);
    double* const to = i < 3 ? t.X[i] : X;
    for (int k = 0; k < 3; ++k) to[k] = p.points[3 * row + k];
    for (int k = 0; k < 2; ++k) x[k] = p.pixels[2 * row + k];
    if (i == 3) break;
    double const y = (x[1] - K[5] / K[8]) * K[8] / K[4];
    t.rays[i][0] = ((x[0] - K[2] / K[8]) * K[8] - K[1] * y) / K[0];
    t.rays[i][1] = y;
    t.rays[i][2] = 1;
  }
  measure(t);
  int const count = is_flat(t) ? 0 : distances(t, found);
  for (double& v : pose) v = small::nan();
  for (int i = 0; i < count; ++i) {
    double c[3], h[3];
    pose_of(t, found[i], one);
    for (int k = 0; k < 3; ++k) c[k] = dot3(one + 4 * k, X) + one[4 * k + 3];
    for (int k = 0; k < 3; ++k) h[k] = dot3(K + 3 * k, c);
    double const u = h[0] / h[2] - x[0], v = h[1] / h[2] - x[1], error = u * u + v * v;
    if (!(h[2] > 0) || !(error < least)) continue;
    least = error;
    for (int k = 0; k < 12; ++k) pose[k] = one[k];
  }
  for (int k = 0; k < 12; ++k) p.poses.set(12 * at + k, pose[k]);
}

}  // namespace kv::geometry
