// Direct linear transformation: what relates correspondences, as the least squares of equations that are linear in its
// numbers, in one pass of few numbers; and its gradient.
//
//   n = s (p - m)            each image's weighted mean m goes to 0, its mean distance d to sqrt(D): s = sqrt(D) / (d +
//                            eps) for points of D numbers
//   M = sum w r r^T          of the rows r of each correspondence; h is the smallest eigenvector of M
//
// A homography takes n1 = (u, v, 1) to (x, y) = n2, a camera points of space (u, v, w, 1):
//   r = (0, -n1, y n1), (n1, 0, -x n1), and T2^-1 h T1 in pixels
// One that takes both ends n1 of segments to lines l = (x, y, 1) x (x', y', 1) of others has l^T h n1 = 0:
//   r = the products of l and n1
// A fundamental matrix has n2^T F n1 = 0 for n2 = (x, y, 1):
//   r = the products of n2 and n1, and T2^T h T1, h without what it does to its smallest singular vector
//
// An affine map is no such case, but the same to its callers: A (p1 - m1) is the least squares of p2 - m2.
//
// Homographies and fundamental matrices are divided by their last number unless that is 0. A camera becomes a pose: its
// pictures are K^-1 (x, y, 1), the columns of its rotation are made orthogonal one after the other, and the first one
// gives the scale.
//
// Included by dlt_cpu.cpp, dlt.cu and dlt_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv {

enum class DltModel : int { homography, lines, fundamental, pose, affine };

template <class T>
struct Dlt {
  DltModel model;
  Reals points1, points2, weights;  // (B, N, 2), (B, N, 3) of a pose; (B, N, 2); (B, N) or null. Of lines (B, N, 2, 2)
  Reals camera;                     // (B, 3, 3) of a pose
  int64_t batch, count, stride;     // from the points of a problem to the next one's: 0 where all have the same
  double flat;                      // points of a pose whose least extent is below that have none
  Reals found;                      // (B, 3, 3), (B, 3, 4) of a pose
  // For the gradient only:
  Reals grad, grad1, grad2, grad_weights, grad_camera;
};

KV_KERNEL(dlt, Dlt)
KV_KERNEL(dlt_backward, Dlt)

// Points as they are normalised above, on their own, and the matrix that does it.
template <class T>
struct NormalizedPoints {
  Reals points, weights;  // (B, N, 2), (B, N) or null
  int64_t batch, count;
  double eps;
  Reals normalized, matrix;  // (B, N, 2), (B, 3, 3)
  // For the gradient only:
  Reals grad, grad_matrix, to_points, to_weights;
};

KV_KERNEL(normalize_points, NormalizedPoints)
KV_KERNEL(normalize_points_backward, NormalizedPoints)

namespace dlt_steps {

constexpr double kEps = 1e-8;

// The weights of one problem as they stand in M, and as shares of the means: none below 0, alike where all are 0.
struct Weights {
  Reals weights;
  int64_t first, count;
  bool squared;
  double total, inverse, alike;
  template <class Team>
  KV_HD Weights(Reals weights, int64_t b, int64_t count, bool squared, Team team)
      : weights(weights),
        first(b * count),
        count(count),
        squared(squared),
        total(0),
        inverse(0),
        alike(1 / double(count)) {
    if (!weights.data) return;
    for (int64_t i = team.first(); i < count; i += team.step()) total += positive(i);
    total = team.sum(total);
    inverse = 1 / total;
  }
  KV_HD double operator[](int64_t i) const {
    if (!weights.data) return 1;
    double const w = weights[first + i];
    return squared ? w * w : w;
  }
  KV_HD double positive(int64_t i) const {
    double const w = (*this)[i];
    return w < 0 ? 0 : w;
  }
  KV_HD bool shared() const { return weights.data && total != 0; }
  KV_HD double share(int64_t i) const { return shared() ? positive(i) * inverse : alike; }
};

// (x, y) of K^-1 (px, py, 1) at z = 1, for an upper triangular K, or pixels as they are.
struct Calibration {
  Reals camera;
  int64_t at;
  KV_HD double k(int i) const { return camera[at + i]; }
  KV_HD void apply(double* p) const {
    if (!camera.data) return;
    p[1] = (p[1] * k(8) - k(5)) / k(4);
    p[0] = (p[0] * k(8) - k(2) - k(1) * p[1]) / k(0);
  }
  // g, the gradient to the result (x, y), becomes that to the pixel p; adds that to K's six numbers to `sums`.
  KV_HD void vjp(double const* p, double const* xy, double* g, double* sums) const {
    double const across = g[0] / k(0), down = (g[1] - across * k(1)) / k(4);
    sums[0] -= across * xy[0], sums[1] -= across * xy[1], sums[2] -= across;
    sums[3] -= down * xy[1], sums[4] -= down;
    sums[5] += across * p[0] + down * p[1];
    g[0] = across * k(8), g[1] = down * k(8);
  }
};

// The points of one image, D numbers each, and what normalises them.
template <int D>
struct Image {
  Reals points;
  int64_t start;
  Calibration calibration;
  double mean[D], distance, scale;

  static KV_HD double root() { return D == 2 ? 1.4142135623730951 : 1.7320508075688772; }

  // With so many points of a weight.
  template <int kPoints, class Team>
  KV_HD void normalize(Weights const& w, double eps, Team team) {
    double sum[D] = {}, total = 0, at[D];
    for (int64_t i = team.first(); i < kPoints * w.count; i += team.step()) {
      point(i, at);
      for (int k = 0; k < D; ++k) sum[k] += w.share(i / kPoints) / kPoints * at[k];
    }
    for (int k = 0; k < D; ++k) mean[k] = team.sum(sum[k]);
    for (int64_t i = team.first(); i < kPoints * w.count; i += team.step())
      total += w.share(i / kPoints) / kPoints * from_mean(i, at);
    distance = team.sum(total);
    scale = root() / (distance + eps);
  }
  KV_HD void point(int64_t i, double* at) const {
    for (int k = 0; k < D; ++k) at[k] = points[D * (start + i) + k];
    if constexpr (D == 2) calibration.apply(at);
  }
  KV_HD double from_mean(int64_t i, double* at) const {
    point(i, at);
    double square = 0;
    for (int k = 0; k < D; ++k) at[k] -= mean[k], square += at[k] * at[k];
    return sqrt(square);
  }
};

// The gradient to an image's points: that to the normalised ones, and that to the scale and the mean by other ways.
// First it is summed up, by `add` and `finish`, then to_point has it.
template <int D>
struct ImageSlopes {
  double scale, mean[D];
  double distance, apart[D];  // apart: the mean of (p - m) / |p - m|

  KV_HD ImageSlopes() : scale(0), mean{}, distance(0), apart{} {}
  KV_HD void add(Image<D> const& image, int64_t i, double share, double const* g) {
    double at[D], length = image.from_mean(i, at);
    for (int k = 0; k < D; ++k) {
      mean[k] -= image.scale * g[k];
      scale += g[k] * at[k];
      if (length > 0) apart[k] += share * at[k] / length;
    }
  }
  template <class Team>
  KV_HD void finish(Image<D> const& image, Team team) {
    scale = team.sum(scale);
    distance = -scale * image.scale * image.scale / Image<D>::root();
    for (int k = 0; k < D; ++k) mean[k] = team.sum(mean[k]) - distance * team.sum(apart[k]);
  }
  KV_HD double to_share(Image<D> const& image, int64_t i) const {
    double at[D], sum = distance * image.from_mean(i, at);
    for (int k = 0; k < D; ++k) sum += mean[k] * (at[k] + image.mean[k]);
    return sum;
  }
  KV_HD void to_point(Image<D> const& image, int64_t i, double share, double* g) const {
    double at[D], length = image.from_mean(i, at);
    for (int k = 0; k < D; ++k) {
      double const outward = length > 0 ? distance * at[k] / length : 0;
      g[k] = image.scale * g[k] + share * (outward + mean[k]);
    }
  }
};

// Of correspondences that have so many points each.
template <int D, int kPoints = 1>
struct Problem {
  static constexpr int kColumns = D + 1;
  Weights weights;
  Image<D> one;
  Image<2> two;

  template <class T, class Team>
  KV_HD Problem(Dlt<T> const& p, int64_t b, Team team)
      : weights(p.weights, b, p.count, p.model == DltModel::pose, team),
        one{p.points1, b * p.stride, {}, {}, 0, 0},
        two{p.points2, b * p.stride, {p.camera, 9 * b}, {}, 0, 0} {
    one.template normalize<kPoints>(weights, kEps, team);
    two.template normalize<kPoints>(weights, kEps, team);
  }
  KV_HD double share(int64_t i) const { return weights.share(i) / kPoints; }  // of a point of correspondence i
  // Both normalised, with a 1.
  KV_HD void normalized(int64_t i, double* n1, double* n2) const {
    one.from_mean(i, n1);
    two.from_mean(i, n2);
    for (int k = 0; k < D; ++k) n1[k] *= one.scale;
    for (int k = 0; k < 2; ++k) n2[k] *= two.scale;
    n1[D] = n2[2] = 1;
  }
  // h T1, for a matrix of three rows.
  KV_HD void before(double const* h, double* m) const {
    for (int r = 0; r < 3; ++r, h += kColumns, m += kColumns) {
      m[D] = h[D];
      for (int k = 0; k < D; ++k) m[k] = one.scale * h[k], m[D] -= m[k] * one.mean[k];
    }
  }
  // From the gradient g to that: to h, in place, and to the first image.
  KV_HD void before_vjp(double const* h, double* g, ImageSlopes<D>& to_one) const {
    for (int r = 0; r < 3; ++r, h += kColumns, g += kColumns)
      for (int k = 0; k < D; ++k) {
        double const inner = g[k] - g[D] * one.mean[k];
        to_one.scale += inner * h[k];
        to_one.mean[k] -= g[D] * one.scale * h[k];
        g[k] = one.scale * inner;
      }
  }
};

template <int C>
KV_HD double product(double const* a, double const* b) {
  double sum = 0;
  for (int k = 0; k < C; ++k) sum += a[k] * b[k];
  return sum;
}

// Where a symmetric matrix has its number (i, k) among those on and below the diagonal, row by row.
KV_HD int below(int i, int k) { return i > k ? i * (i + 1) / 2 + k : k * (k + 1) / 2 + i; }

// --- what takes points of D numbers to the second image --------------------------------------------------------------

template <int D>
struct Projective {
  static constexpr int kAxes = D, kPoints = 1, C = D + 1, kUnknowns = 3 * C;

  // M, which all of the team see, has five different blocks, of which two are 0: sums of w, -w x, -w y, w (x^2 + y^2)
  // times n1 n1^T.
  template <class Team>
  static KV_CALLED void normal_matrix(Problem<D> const& problem, Team team, double* m) {
    constexpr int kSums = C * (C + 1) / 2;
    double sums[4 * kSums] = {};
    for (int64_t i = team.first(); i < problem.weights.count; i += team.step()) {
      double n1[C], n2[3];
      problem.normalized(i, n1, n2);
      double const w = problem.weights[i];
      double const factors[] = {w, -w * n2[0], -w * n2[1], w * (n2[0] * n2[0] + n2[1] * n2[1])};
      for (int r = 0, at = 0; r < C; ++r)
        for (int c = 0; c <= r; ++c, ++at)
          for (int f = 0; f < 4; ++f) sums[f * kSums + at] += factors[f] * n1[r] * n1[c];
    }
    double const* const all = team.sums(sums);
    for (int row = team.first(); row < kUnknowns; row += team.step()) {
      int const r = row / C, i = row % C;
      for (int c = 0; c < 3; ++c) {
        double const* const block = all + (r == c ? (r == 2 ? 3 : 0) : r + c - 1) * kSums;
        for (int k = 0; k < C; ++k) m[row * kUnknowns + c * C + k] = r != c && r + c == 1 ? 0 : block[below(i, k)];
      }
    }
    team.sync();
  }

  // Of -u^T (sum w r r^T) h to a correspondence: gives it to w, and to the normalised points in g1 and g2.
  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double const x = n2[0], y = n2[1], square = x * x + y * y;
    double a[3], c[3];
    for (int k = 0; k < 3; ++k) a[k] = product<C>(u + C * k, n1), c[k] = product<C>(h + C * k, n1);
    double const cross_x = a[0] * c[2] + a[2] * c[0], cross_y = a[1] * c[2] + a[2] * c[1];
    g2[0] = -w * (2 * x * a[2] * c[2] - cross_x);
    g2[1] = -w * (2 * y * a[2] * c[2] - cross_y);
    double const to_a[] = {c[0] - x * c[2], c[1] - y * c[2], square * c[2] - x * c[0] - y * c[1]};
    double const to_c[] = {a[0] - x * a[2], a[1] - y * a[2], square * a[2] - x * a[0] - y * a[1]};
    for (int k = 0; k < D; ++k) {
      g1[k] = 0;
      for (int r = 0; r < 3; ++r) g1[k] -= w * (to_a[r] * u[C * r + k] + to_c[r] * h[C * r + k]);
    }
    return -(a[0] * c[0] + a[1] * c[1] + square * a[2] * c[2] - x * cross_x - y * cross_y);
  }

  // What is found of h: h itself.
  static KV_HD void constrain(double const* h, double* f) {
    for (int i = 0; i < kUnknowns; ++i) f[i] = h[i];
  }
  static KV_HD void constrain_vjp(double const*, double*) {}

  // T2^-1 times a matrix, up to a factor.
  static KV_HD void after(Image<2> const& two, double const* before, double* m) {
    double const* const last = before + 2 * C;
    for (int k = 0; k < C; ++k) {
      for (int r = 0; r < 2; ++r) m[r * C + k] = before[r * C + k] + two.scale * two.mean[r] * last[k];
      m[2 * C + k] = two.scale * last[k];
    }
  }
  static KV_HD void after_vjp(Image<2> const& two, double const* before, double* g, ImageSlopes<2>& to_two) {
    double const* const last = before + 2 * C;
    for (int k = 0; k < C; ++k) {
      for (int r = 0; r < 2; ++r) to_two.mean[r] += two.scale * g[r * C + k] * last[k];
      double const by_scale = two.mean[0] * g[k] + two.mean[1] * g[C + k] + g[2 * C + k];
      to_two.scale += by_scale * last[k];
      g[2 * C + k] = two.scale * by_scale;
    }
  }
};

// What a matrix is divided by: its last number, or its largest one where that is 0.
KV_HD double divisor(double const* m, bool& last) {
  double largest = 0;
  for (int i = 0; i < 9; ++i) largest = max(largest, small::magnitude(m[i]));
  last = small::magnitude(m[8]) > 1e-12 * largest;
  return last ? m[8] : largest > 0 ? largest : 1;
}

KV_HD void to_unit_last(double const* m, double* found) {
  bool last;
  double const scale = 1 / divisor(m, last);
  for (int i = 0; i < 9; ++i) found[i] = m[i] * scale;
}
KV_HD void to_unit_last_vjp(double const* m, double* g) {
  bool last;
  double const scale = 1 / divisor(m, last);
  double along = 0;
  for (int i = 0; i < 9; ++i) g[i] *= scale, along += g[i] * m[i] * scale;
  if (last) g[8] -= along;
}

struct Homography : Projective<2> {
  static constexpr int kNumbers = 9;
  static KV_HD void finish(double const* m, double* found) { to_unit_last(m, found); }
  static KV_HD void finish_vjp(double const* m, double* g) { to_unit_last_vjp(m, g); }
  template <class T, class Team>
  static KV_HD bool possible(Dlt<T> const&, Problem<2> const&, Team) {
    return true;
  }
};

// To m, which all of the team see, the sum of w l l^T times n1 n1^T: of six different products of each. `pair` gives w,
// n1 and l, numbers of three, of a point of either.
template <class Team, class Pair>
KV_HD void sum_products(int64_t count, Team team, Pair pair, double* m) {
  double sums[36] = {};
  for (int64_t i = team.first(); i < count; i += team.step()) {
    double n1[3], n2[3], products[6];
    double const w = pair(i, n1, n2);
    for (int r = 0, at = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++at) products[at] = n1[r] * n1[c];
    for (int r = 0, at = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++at)
        for (int k = 0; k < 6; ++k) sums[6 * at + k] += w * n2[r] * n2[c] * products[k];
  }
  double const* const all = team.sums(sums);
  for (int row = team.first(); row < 9; row += team.step())
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < 3; ++k) m[9 * row + 3 * c + k] = all[6 * below(row / 3, c) + below(row % 3, k)];
  team.sync();
}

// --- homographies of segments, whose points are their ends -----------------------------------------------------------

struct Lines : Homography {
  static constexpr int kPoints = 2;

  template <class Team>
  static KV_CALLED void normal_matrix(Problem<2, 2> const& problem, Team team, double* m) {
    auto const end = [&](int64_t i, double* n1, double* line) KV_INLINE {
      double start[3], end[3], other[3];
      problem.normalized(i ^ 1, other, start);
      problem.normalized(i, n1, end);
      small::cross(start, end, line);  // of either sign
      return problem.weights[i / 2];
    };
    sum_products(2 * problem.weights.count, team, end, m);
  }
  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double line[3], to_line[3] = {}, to_ends[3], to_weight = 0;
    small::cross(n2, n2 + 3, line);
    for (int end = 0; end < 2; ++end) {
      double by_u[3], by_h[3];
      for (int r = 0; r < 3; ++r)
        by_u[r] = small::dot3(u + 3 * r, n1 + 3 * end), by_h[r] = small::dot3(h + 3 * r, n1 + 3 * end);
      double const a = small::dot3(by_u, line), c = small::dot3(by_h, line);
      to_weight -= a * c;
      for (int k = 0; k < 3; ++k) to_line[k] -= w * (c * by_u[k] + a * by_h[k]);
      for (int k = 0; k < 2; ++k) {
        g1[2 * end + k] = 0;
        for (int r = 0; r < 3; ++r) g1[2 * end + k] -= w * line[r] * (c * u[3 * r + k] + a * h[3 * r + k]);
      }
    }
    small::cross(n2 + 3, to_line, to_ends);
    g2[0] = to_ends[0], g2[1] = to_ends[1];
    small::cross(to_line, n2, to_ends);
    g2[2] = to_ends[0], g2[3] = to_ends[1];
    return to_weight;
  }
  template <class T, class Team>
  static KV_HD bool possible(Dlt<T> const&, Problem<2, 2> const&, Team) {
    return true;
  }
};

// --- poses -----------------------------------------------------------------------------------------------------------

// Of a camera (3, 4) of any scale and sign: the columns of a rotation, one after the other, and the translation.
struct Gram {
  double sign, size, along, second_size;
  double first[3], second[3], third[3], b[3], t[3];

  KV_HD static double nonzero(double x) { return x > 0 ? x : 1; }
  KV_HD explicit Gram(double const* m) {
    double a[3], c[3], ab[3];
    for (int i = 0; i < 3; ++i) a[i] = m[4 * i], b[i] = m[4 * i + 1], c[i] = m[4 * i + 2], t[i] = m[4 * i + 3];
    small::cross(a, b, ab);
    sign = small::dot3(ab, c) < 0 ? -1 : 1;
    size = nonzero(sqrt(small::dot3(a, a)));
    for (int i = 0; i < 3; ++i) first[i] = sign * a[i] / size, b[i] *= sign, t[i] *= sign / size;
    along = small::dot3(first, b);
    for (int i = 0; i < 3; ++i) second[i] = b[i] - along * first[i];
    second_size = nonzero(sqrt(small::dot3(second, second)));
    for (double& x : second) x /= second_size;
    small::cross(first, second, third);
  }
};

struct Pose : Projective<3> {
  static constexpr int kNumbers = 12;

  static KV_CALLED void finish(double const* m, double* found) {
    Gram const r(m);
    for (int i = 0; i < 3; ++i)
      found[4 * i] = r.first[i], found[4 * i + 1] = r.second[i], found[4 * i + 2] = r.third[i],
                found[4 * i + 3] = r.t[i];
  }
  static KV_CALLED void finish_vjp(double const* m, double* g) {
    Gram const r(m);
    double to_first[3], to_second[3], to_third[3], to_t[3], more[3];
    for (int i = 0; i < 3; ++i)
      to_first[i] = g[4 * i], to_second[i] = g[4 * i + 1], to_third[i] = g[4 * i + 2], to_t[i] = g[4 * i + 3];
    small::cross(r.second, to_third, more);
    for (int i = 0; i < 3; ++i) to_first[i] += more[i];
    small::cross(to_third, r.first, more);
    for (int i = 0; i < 3; ++i) to_second[i] += more[i];
    double const outward = small::dot3(r.second, to_second);
    double to_b[3];
    for (int i = 0; i < 3; ++i) to_b[i] = (to_second[i] - r.second[i] * outward) / r.second_size;
    double const to_along = -small::dot3(to_b, r.first);
    for (int i = 0; i < 3; ++i) {
      to_first[i] += to_along * r.b[i] - r.along * to_b[i];
      to_b[i] += to_along * r.first[i];
    }
    double const spin = small::dot3(r.first, to_first), stretch = small::dot3(r.t, to_t);
    for (int i = 0; i < 3; ++i) {
      g[4 * i] = r.sign * (to_first[i] - (spin + stretch) * r.first[i]) / r.size;
      g[4 * i + 1] = r.sign * to_b[i];
      g[4 * i + 2] = 0;
      g[4 * i + 3] = r.sign * to_t[i] / r.size;
    }
  }

  // Whether the points are in no plane: by the least singular value of the normalised ones, weights being 1 on average.
  template <class T, class Team>
  static KV_CALLED bool possible(Dlt<T> const& p, Problem<3> const& problem, Team team) {
    double sums[6] = {}, used = 0, m[9], copy[9], v[3];
    for (int64_t i = team.first(); i < p.count; i += team.step()) {
      double at[3];
      problem.one.from_mean(i, at);
      double const w = problem.weights[i];
      used += w > 0;
      for (int r = 0, to = 0; r < 3; ++r)
        for (int c = 0; c <= r; ++c, ++to) sums[to] += w * at[r] * at[c];
    }
    used = team.sum(used);
    double const mean = problem.weights.weights.data ? used / problem.weights.total : 1;
    double const scale = problem.one.scale * problem.one.scale * mean;
    for (int r = 0, from = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++from) m[3 * r + c] = m[3 * c + r] = scale * team.sum(sums[from]);
    for (int i = 0; i < 9; ++i) copy[i] = m[i];
    small::smallest_eigenvector<3>(copy, v);
    double square = 0;
    for (int r = 0; r < 3; ++r) square += v[r] * small::dot3(m + 3 * r, v);
    return !(sqrt(square > 0 ? square : 0) < p.flat);
  }
};

// --- fundamental matrices --------------------------------------------------------------------------------------------

struct Fundamental {
  static constexpr int kAxes = 2, kPoints = 1, kUnknowns = 9, kNumbers = 9;

  template <class Team>
  static KV_CALLED void normal_matrix(Problem<2> const& problem, Team team, double* m) {
    auto const pair = [&](int64_t i, double* n1, double* n2) KV_INLINE {
      problem.normalized(i, n1, n2);
      return problem.weights[i];
    };
    sum_products(problem.weights.count, team, pair, m);
  }

  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double by_u[3], by_h[3];
    for (int r = 0; r < 3; ++r) by_u[r] = small::dot3(u + 3 * r, n1), by_h[r] = small::dot3(h + 3 * r, n1);
    double const a = small::dot3(by_u, n2), c = small::dot3(by_h, n2);
    for (int k = 0; k < 2; ++k) {
      g2[k] = -w * (c * by_u[k] + a * by_h[k]);
      g1[k] = 0;
      for (int r = 0; r < 3; ++r) g1[k] -= w * n2[r] * (c * u[3 * r + k] + a * h[3 * r + k]);
    }
    return -a * c;
  }

  static KV_HD void constrain(double const* h, double* f) {
    double v[3];
    for (int i = 0; i < 9; ++i) f[i] = h[i];
    small::to_rank_two(f, v);
  }
  // Of F - F v v^T for the smallest eigenvector v of F^T F.
  static KV_CALLED void constrain_vjp(double const* h, double* g) {
    double f[9], v[3], square[9], to_v[3], u[3], fv[3], gv[3], fu[3];
    for (int i = 0; i < 9; ++i) f[i] = h[i];
    if (!small::to_rank_two(f, v)) return;
    for (int r = 0; r < 3; ++r) fv[r] = small::dot3(h + 3 * r, v), gv[r] = small::dot3(g + 3 * r, v);
    for (int i = 0; i < 3; ++i) {
      to_v[i] = 0;
      for (int r = 0; r < 3; ++r) to_v[i] -= h[3 * r + i] * gv[r] + g[3 * r + i] * fv[r];
      for (int k = 0; k < 3; ++k) square[3 * i + k] = h[i] * h[k] + h[3 + i] * h[3 + k] + h[6 + i] * h[6 + k];
    }
    small::smallest_eigenvector_vjp<3>(square, v, to_v, u);
    for (int r = 0; r < 3; ++r) fu[r] = small::dot3(h + 3 * r, u);
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 3; ++k) g[3 * r + k] -= gv[r] * v[k] + fu[r] * v[k] + fv[r] * u[k];
  }

  // T2^T times a matrix.
  static KV_HD void after(Image<2> const& two, double const* before, double* m) {
    for (int k = 0; k < 3; ++k) {
      for (int r = 0; r < 2; ++r) m[3 * r + k] = two.scale * before[3 * r + k];
      m[6 + k] = before[6 + k] - m[k] * two.mean[0] - m[3 + k] * two.mean[1];
    }
  }
  static KV_HD void after_vjp(Image<2> const& two, double const* before, double* g, ImageSlopes<2>& to_two) {
    for (int k = 0; k < 3; ++k)
      for (int r = 0; r < 2; ++r) {
        double const inner = g[3 * r + k] - g[6 + k] * two.mean[r];
        to_two.scale += inner * before[3 * r + k];
        to_two.mean[r] -= g[6 + k] * two.scale * before[3 * r + k];
        g[3 * r + k] = two.scale * inner;
      }
  }
  static KV_HD void finish(double const* m, double* found) { to_unit_last(m, found); }
  static KV_HD void finish_vjp(double const* m, double* g) { to_unit_last_vjp(m, g); }
  template <class T, class Team>
  static KV_HD bool possible(Dlt<T> const&, Problem<2> const&, Team) {
    return true;
  }
};

// --- affine maps -----------------------------------------------------------------------------------------------------

struct Affine {};

struct AffineFit {
  double inverse[4], across[4], linear[4];  // of S = sum w x x^T; C = sum w x y^T; A = (S^-1 C)^T
  bool flat;

  template <class Team>
  KV_HD AffineFit(Problem<2> const& problem, Team team) {
    double sums[7] = {};
    for (int64_t i = team.first(); i < problem.weights.count; i += team.step()) {
      double x[2], y[2];
      problem.one.from_mean(i, x);
      problem.two.from_mean(i, y);
      double const w = problem.weights.share(i);
      sums[0] += w * x[0] * x[0], sums[1] += w * x[0] * x[1], sums[2] += w * x[1] * x[1];
      for (int k = 0; k < 4; ++k) sums[3 + k] += w * x[k / 2] * y[k % 2];
    }
    for (double& sum : sums) sum = team.sum(sum);
    double const trace = sums[0] + sums[2], area = sums[0] * sums[2] - sums[1] * sums[1];
    flat = !(area > 1e-12 * trace * trace);
    inverse[0] = sums[2] / area, inverse[3] = sums[0] / area;
    inverse[1] = inverse[2] = -sums[1] / area;
    for (int k = 0; k < 4; ++k) across[k] = sums[3 + k];
    for (int r = 0; r < 2; ++r)
      for (int c = 0; c < 2; ++c) linear[2 * r + c] = inverse[2 * c] * across[r] + inverse[2 * c + 1] * across[2 + r];
  }
};

}  // namespace dlt_steps

template <class Model, class T, class Team>
KV_HD void dlt_of(Model, Dlt<T> const& p, int64_t b, Team team) {
  constexpr int n = Model::kUnknowns;
  dlt_steps::Problem<Model::kAxes, Model::kPoints> const problem(p, b, team);
  typename Team::template Kept<small::EigenSpace<n>> kept;
  small::EigenSpace<n>& space = kept.get();
  bool const possible = Model::possible(p, problem, team);
  Model::normal_matrix(problem, team, space.matrix);
  auto const few = team.few();
  if (few.idle()) return;
  small::smallest_eigenvector<n>(space, few);
  if (team.first() != 0) return;
  double f[n], before[n], found[n];
  Model::constrain(space.v, f);
  problem.before(f, before);
  Model::after(problem.two, before, f);
  Model::finish(f, found);
  for (int i = 0; i < n; ++i) p.found.set(n * b + i, possible ? found[i] : small::nan());
}

template <class Model, class T, class Team>
KV_HD void dlt_backward_of(Model, Dlt<T> const& p, int64_t b, Team team) {
  constexpr int n = Model::kUnknowns, D = Model::kAxes, kPoints = Model::kPoints;
  dlt_steps::Problem<D, kPoints> const problem(p, b, team);
  dlt_steps::Image<D> const& one = problem.one;
  dlt_steps::Image<2> const& two = problem.two;
  dlt_steps::ImageSlopes<D> to_one;
  dlt_steps::ImageSlopes<2> to_two;
  dlt_steps::Weights const& weights = problem.weights;
  typename Team::template Kept<small::EigenSpace<n>> kept;
  small::EigenSpace<n>& space = kept.get();
  double const *const h = space.v, *const u = space.u;
  bool const possible = Model::possible(p, problem, team);
  Model::normal_matrix(problem, team, space.matrix);
  auto const few = team.few();
  if (!few.idle()) small::smallest_eigenvector<n>(space, few);
  if (team.first() == 0) {
    double f[n], before[n], after[n], g[n];
    Model::constrain(h, f);
    problem.before(f, before);
    Model::after(two, before, after);
    for (int i = 0; i < n; ++i) g[i] = possible ? p.grad[n * b + i] : 0;
    Model::finish_vjp(after, g);
    Model::after_vjp(two, before, g, to_two);
    problem.before_vjp(f, g, to_one);
    Model::constrain_vjp(h, g);
    for (int i = 0; i < n; ++i) space.g[i] = g[i];
  }
  if (!few.idle()) {
    few.sync();
    small::smallest_eigenvector_vjp<n>(space, few);
  }
  team.sync();

  // The gradients to the points of correspondence i, normalised; gives that to its weight.
  auto const slopes = [&](int64_t i, double* g1, double* g2) KV_INLINE {
    double n1[kPoints * (D + 1)], n2[kPoints * 3];
    for (int e = 0; e < kPoints; ++e) problem.normalized(kPoints * i + e, n1 + (D + 1) * e, n2 + 3 * e);
    return Model::row_vjp(weights[i], u, h, n1, n2, g1, g2);
  };
  double g1[kPoints * D], g2[kPoints * 2];
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    slopes(i, g1, g2);
    for (int e = 0; e < kPoints; ++e) {
      to_one.add(one, kPoints * i + e, problem.share(i), g1 + D * e);
      to_two.add(two, kPoints * i + e, problem.share(i), g2 + 2 * e);
    }
  }
  to_one.finish(one, team);
  to_two.finish(two, team);

  // To points, and to shares, whose sum is 1.
  double common = 0, to_camera[6] = {};
  auto const to_share = [&](int64_t i) KV_INLINE {
    double sum = 0;
    for (int64_t e = kPoints * i; e < kPoints * (i + 1); ++e) sum += to_one.to_share(one, e) + to_two.to_share(two, e);
    return sum / kPoints;
  };
  if (weights.shared()) {
    for (int64_t i = team.first(); i < p.count; i += team.step()) common += weights.share(i) * to_share(i);
    common = team.sum(common);
  }
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    double to_weight = slopes(i, g1, g2);
    for (int e = 0; e < kPoints; ++e) {
      to_one.to_point(one, kPoints * i + e, problem.share(i), g1 + D * e);
      to_two.to_point(two, kPoints * i + e, problem.share(i), g2 + 2 * e);
    }
    if (weights.shared() && weights[i] >= 0) to_weight += (to_share(i) - common) / weights.total;
    if (weights.squared && weights.weights.data) to_weight *= 2 * weights.weights[weights.first + i];
    if (two.calibration.camera.data) {
      double pixel[2], xy[2];
      two.point(i, xy);
      for (int k = 0; k < 2; ++k) pixel[k] = two.points[2 * (two.start + i) + k];
      two.calibration.vjp(pixel, xy, g2, to_camera);
    }
    for (int k = 0; k < kPoints * D; ++k) p.grad1.set(D * (one.start + kPoints * i) + k, g1[k]);
    for (int k = 0; k < kPoints * 2; ++k) p.grad2.set(2 * (two.start + kPoints * i) + k, g2[k]);
    p.grad_weights.set(b * p.count + i, to_weight);
  }
  if (!two.calibration.camera.data) return;
  constexpr int places[] = {0, 1, 2, 4, 5, 8};
  for (double& x : to_camera) x = team.sum(x);
  if (team.first() != 0) return;
  for (int i = 0; i < 9; ++i) p.grad_camera.set(9 * b + i, 0);
  for (int i = 0; i < 6; ++i) p.grad_camera.set(9 * b + places[i], to_camera[i]);
}

template <class T, class Team>
KV_HD void dlt_of(dlt_steps::Affine, Dlt<T> const& p, int64_t b, Team team) {
  dlt_steps::Problem<2> const problem(p, b, team);
  dlt_steps::AffineFit const map(problem, team);
  if (team.first() != 0) return;
  for (int r = 0; r < 2; ++r) {
    double const *const row = map.linear + 2 * r, *const mean = problem.one.mean;
    double const found[] = {row[0], row[1], problem.two.mean[r] - row[0] * mean[0] - row[1] * mean[1]};
    for (int k = 0; k < 3; ++k) p.found.set(9 * b + 3 * r + k, map.flat ? small::nan() : found[k]);
  }
  for (int k = 0; k < 3; ++k) p.found.set(9 * b + 6 + k, k == 2);
}

template <class T, class Team>
KV_HD void dlt_backward_of(dlt_steps::Affine, Dlt<T> const& p, int64_t b, Team team) {
  dlt_steps::Problem<2> const problem(p, b, team);
  dlt_steps::AffineFit const map(problem, team);
  dlt_steps::Weights const& weights = problem.weights;
  // To S, to C, and to both means.
  double to_map[4], to_across[4], to_square[4], to_mean1[2] = {}, to_mean2[2];
  for (int r = 0; r < 2; ++r) {
    double const shift = map.flat ? 0 : p.grad[9 * b + 3 * r + 2];
    to_mean2[r] = shift;
    for (int c = 0; c < 2; ++c) {
      to_mean1[c] -= map.flat ? 0 : shift * map.linear[2 * r + c];
      to_map[2 * r + c] = map.flat ? 0 : p.grad[9 * b + 3 * r + c] - shift * problem.one.mean[c];
    }
  }
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k)
      to_across[2 * i + k] =
          map.flat ? 0 : map.inverse[2 * i] * to_map[2 * k] + map.inverse[2 * i + 1] * to_map[2 * k + 1];
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k)
      to_square[2 * i + k] =
          map.flat ? 0 : -(to_across[2 * i] * map.linear[k] + to_across[2 * i + 1] * map.linear[2 + k]);

  // Of a correspondence: what both points' gradients are over its share; gives that to the share.
  auto const slopes = [&](int64_t i, double* g1, double* g2) KV_INLINE {
    double x[2], y[2], to_share = 0;
    problem.one.from_mean(i, x);
    problem.two.from_mean(i, y);
    for (int k = 0; k < 2; ++k) {
      double const by_square = to_square[2 * k] * x[0] + to_square[2 * k + 1] * x[1];
      double const by_across = to_across[2 * k] * y[0] + to_across[2 * k + 1] * y[1];
      to_share += x[k] * (by_square + by_across);
      g1[k] = by_square + to_square[k] * x[0] + to_square[2 + k] * x[1] + by_across + to_mean1[k];
      g2[k] = to_across[k] * x[0] + to_across[2 + k] * x[1] + to_mean2[k];
      to_share += to_mean1[k] * (x[k] + problem.one.mean[k]) + to_mean2[k] * (y[k] + problem.two.mean[k]);
    }
    return to_share;
  };
  double common = 0, g1[2], g2[2];
  for (int64_t i = team.first(); i < p.count; i += team.step()) common += weights.share(i) * slopes(i, g1, g2);
  common = team.sum(common);
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    double const to_share = slopes(i, g1, g2), share = weights.share(i);
    for (int k = 0; k < 2; ++k) {
      p.grad1.set(2 * (problem.one.start + i) + k, share * g1[k]);
      p.grad2.set(2 * (problem.two.start + i) + k, share * g2[k]);
    }
    bool const counts = weights.shared() && weights[i] >= 0;
    p.grad_weights.set(b * p.count + i, counts ? (to_share - common) / weights.total : 0);
  }
}

template <class T, class Team>
KV_HD void normalize_points_of(NormalizedPoints<T> const& p, int64_t b, Team team) {
  dlt_steps::Weights const weights(p.weights, b, p.count, false, team);
  dlt_steps::Image<2> image{p.points, b * p.count, {}, {}, 0, 0};
  image.normalize<1>(weights, p.eps, team);
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    double at[2];
    image.from_mean(i, at);
    for (int k = 0; k < 2; ++k) p.normalized.set(2 * (image.start + i) + k, image.scale * at[k]);
  }
  if (team.first() != 0) return;
  for (int i = 0; i < 9; ++i) {
    double const shift = i % 3 == 2 && i < 6 ? -image.scale * image.mean[i / 3] : 0;
    p.matrix.set(9 * b + i, i == 8 ? 1 : i % 4 == 0 ? image.scale : shift);
  }
}

template <class T, class Team>
KV_HD void normalize_points_backward_of(NormalizedPoints<T> const& p, int64_t b, Team team) {
  dlt_steps::Weights const weights(p.weights, b, p.count, false, team);
  dlt_steps::Image<2> image{p.points, b * p.count, {}, {}, 0, 0};
  image.normalize<1>(weights, p.eps, team);
  dlt_steps::ImageSlopes<2> to;
  auto const given = [&](int64_t i, double* g) KV_INLINE {
    for (int k = 0; k < 2; ++k) g[k] = p.grad[2 * (image.start + i) + k];
  };
  double g[2], common = 0;
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    given(i, g);
    to.add(image, i, weights.share(i), g);
  }
  if (team.first() == 0)
    for (int k = 0; k < 2; ++k) {
      double const shift = p.grad_matrix[9 * b + 3 * k + 2];
      to.scale += p.grad_matrix[9 * b + 4 * k] - shift * image.mean[k];
      to.mean[k] -= shift * image.scale;
    }
  to.finish(image, team);
  if (weights.shared()) {
    for (int64_t i = team.first(); i < p.count; i += team.step()) common += weights.share(i) * to.to_share(image, i);
    common = team.sum(common);
  }
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    given(i, g);
    to.to_point(image, i, weights.share(i), g);
    for (int k = 0; k < 2; ++k) p.to_points.set(2 * (image.start + i) + k, g[k]);
    bool const counts = weights.shared() && weights[i] >= 0;
    p.to_weights.set(b * p.count + i, counts ? (to.to_share(image, i) - common) / weights.total : 0);
  }
}

// Calls f with the steps of a model.
template <class F>
KV_HD void with_model(DltModel model, F f) {
  switch (model) {
    case DltModel::homography:
      return f(dlt_steps::Homography{});
    case DltModel::lines:
      return f(dlt_steps::Lines{});
    case DltModel::fundamental:
      return f(dlt_steps::Fundamental{});
    case DltModel::pose:
      return f(dlt_steps::Pose{});
    default:
      return f(dlt_steps::Affine{});
  }
}

}  // namespace kv
