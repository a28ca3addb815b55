// Direct linear transformation (DLT): estimates a model from correspondences by linear least squares, and its gradient.
// One pass over the correspondences sums a small matrix.
//
//   n = s (p - m)        normalized points of an image. m is their weighted mean, and s = sqrt(D) / (d + eps) scales
//                        their mean distance d from it to sqrt(D), for points of D coordinates.
//   M = sum w r r^T      over the rows r of all correspondences. h is the eigenvector of M's smallest eigenvalue.
//
// A homography maps n1 = (u, v, 1) to (x, y) = n2, a camera maps points of space n1 = (u, v, w, 1):
//   r = (0, -n1, y n1), (n1, 0, -x n1). The result is T2^-1 h T1 in pixels.
// A homography of segments maps both ends n1 of a segment to the line l = (x, y, 1) x (x', y', 1) through the ends of
// the other one, l^T h n1 = 0:
//   r = the products of l and n1.
// A fundamental matrix has n2^T F n1 = 0 for n2 = (x, y, 1):
//   r = the products of n2 and n1. The result is T2^T F T1, where F is the matrix of rank 2 that is nearest to h.
//
// An affine map needs no eigenvector, but has the same interface: A (p1 - m1) is fitted to p2 - m2 by least squares.
//
// Homographies and fundamental matrices are divided by their last entry unless that is 0. A camera becomes a pose: its
// image points are K^-1 (x, y, 1). The columns of its rotation are made orthogonal one after the other, and the first
// one determines the scale.
//
// Included by dlt_cpu.cpp, dlt.cu and dlt_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

enum class DltModel : int { homography, lines, fundamental, pose, affine };

template <class T>
struct Dlt {
  DltModel model;
  Reals points1, points2, weights;  // (B, N, 2), pose: (B, N, 3); (B, N, 2); (B, N) or null. Lines: (B, N, 2, 2)
  Reals camera;                     // pose: (B, 3, 3)
  int64_t batch, count, stride;     // stride: between the points of two problems, 0 if all share them
  double min_extent;                // points of a pose with a smaller extent in some direction count as planar: no pose
  Reals result;                     // (B, 3, 3), pose: (B, 3, 4)
  // For the gradient only:
  Reals grad, grad_points1, grad_points2, grad_weights, grad_camera;
};

KV_KERNEL(dlt, Dlt)
KV_KERNEL(dlt_backward, Dlt)

// Only normalizes points, as above, and returns the matrix of the normalization.
template <class T>
struct NormalizedPoints {
  Reals points, weights;  // (B, N, 2), (B, N) or null
  int64_t batch, count;
  double eps;
  Reals normalized, matrix;  // (B, N, 2), (B, 3, 3)
  // For the gradient only:
  Reals grad, grad_matrix, grad_points, grad_weights;
};

KV_KERNEL(normalize_points, NormalizedPoints)
KV_KERNEL(normalize_points_backward, NormalizedPoints)

namespace dlt_models {

constexpr double kEps = 1e-8;

// The weights of a problem: as factors in M, and as fractions of their sum for means. Negative weights count as 0. If
// all are 0, the weights are uniform.
struct Weights {
  Reals weights;
  int64_t first, count;
  bool squared;
  double total, inverse, uniform;
  template <class Group>
  KV_HD Weights(Reals weights, int64_t b, int64_t count, bool squared, Group group)
      : weights(weights),
        first(b * count),
        count(count),
        squared(squared),
        total(0),
        inverse(0),
        uniform(1 / double(count)) {
    if (!weights.data) return;
    for (int64_t i = group.thread_rank(); i < count; i += group.num_threads()) total += positive(i);
    total = group.sum(total);
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
  KV_HD bool is_weighted() const { return weights.data && total != 0; }
  KV_HD double fraction(int64_t i) const { return is_weighted() ? positive(i) * inverse : uniform; }
};

// Pixels (px, py) to image points (x, y) of K^-1 (px, py, 1) at z = 1, for an upper triangular K. Without a camera the
// pixels stay as they are.
struct Calibration {
  Reals camera;
  int64_t offset;
  KV_HD double k(int i) const { return camera[offset + i]; }
  KV_HD void apply(double* p) const {
    if (!camera.data) return;
    p[1] = (p[1] * k(8) - k(5)) / k(4);
    p[0] = (p[0] * k(8) - k(2) - k(1) * p[1]) / k(0);
  }
  // Turns the gradient g to (x, y) into that to the pixel p, and adds that to K's six entries to `sums`.
  KV_HD void vjp(double const* p, double const* xy, double* g, double* sums) const {
    double const grad_u = g[0] / k(0), grad_v = (g[1] - grad_u * k(1)) / k(4);
    sums[0] -= grad_u * xy[0], sums[1] -= grad_u * xy[1], sums[2] -= grad_u;
    sums[3] -= grad_v * xy[1], sums[4] -= grad_v;
    sums[5] += grad_u * p[0] + grad_v * p[1];
    g[0] = grad_u * k(8), g[1] = grad_v * k(8);
  }
};

// The points of one image, D coordinates each, and their normalization.
template <int D>
struct Image {
  Reals points;
  int64_t start;
  Calibration calibration;
  double mean[D], distance, scale;

  static KV_HD double root() { return D == 2 ? 1.4142135623730951 : 1.7320508075688772; }

  // kPoints is the number of points that share a weight.
  template <int kPoints, class Group>
  KV_HD void normalize(Weights const& w, double eps, Group group) {
    double sum[D] = {}, total = 0, at[D];
    for (int64_t i = group.thread_rank(); i < kPoints * w.count; i += group.num_threads()) {
      point(i, at);
      for (int k = 0; k < D; ++k) sum[k] += w.fraction(i / kPoints) / kPoints * at[k];
    }
    for (int k = 0; k < D; ++k) mean[k] = group.sum(sum[k]);
    for (int64_t i = group.thread_rank(); i < kPoints * w.count; i += group.num_threads())
      total += w.fraction(i / kPoints) / kPoints * centered(i, at);
    distance = group.sum(total);
    scale = root() / (distance + eps);
  }
  KV_HD void point(int64_t i, double* at) const {
    for (int k = 0; k < D; ++k) at[k] = points[D * (start + i) + k];
    if constexpr (D == 2) calibration.apply(at);
  }
  KV_HD double centered(int64_t i, double* at) const {
    point(i, at);
    double square = 0;
    for (int k = 0; k < D; ++k) at[k] -= mean[k], square += at[k] * at[k];
    return sqrt(square);
  }
};

// The gradient to an image's points: directly from the normalized points, and through the scale and the mean.
// Call `add` for every point, then `finish`, then `grad_point`.
template <int D>
struct ImageGradients {
  double scale, mean[D];
  double distance, mean_direction[D];  // gradient to the mean distance; mean of (p - m) / |p - m|

  KV_HD ImageGradients() : scale(0), mean{}, distance(0), mean_direction{} {}
  KV_HD void add(Image<D> const& image, int64_t i, double fraction, double const* g) {
    double at[D], length = image.centered(i, at);
    for (int k = 0; k < D; ++k) {
      mean[k] -= image.scale * g[k];
      scale += g[k] * at[k];
      if (length > 0) mean_direction[k] += fraction * at[k] / length;
    }
  }
  template <class Group>
  KV_HD void finish(Image<D> const& image, Group group) {
    scale = group.sum(scale);
    distance = -scale * image.scale * image.scale / Image<D>::root();
    for (int k = 0; k < D; ++k) mean[k] = group.sum(mean[k]) - distance * group.sum(mean_direction[k]);
  }
  KV_HD double grad_fraction(Image<D> const& image, int64_t i) const {
    double at[D], sum = distance * image.centered(i, at);
    for (int k = 0; k < D; ++k) sum += mean[k] * (at[k] + image.mean[k]);
    return sum;
  }
  KV_HD void grad_point(Image<D> const& image, int64_t i, double fraction, double* g) const {
    double at[D], length = image.centered(i, at);
    for (int k = 0; k < D; ++k) {
      double const radial = length > 0 ? distance * at[k] / length : 0;
      g[k] = image.scale * g[k] + fraction * (radial + mean[k]);
    }
  }
};

// The weights and both images of a problem whose correspondences have kPoints points each.
template <int D, int kPoints = 1>
struct Problem {
  static constexpr int kColumns = D + 1;
  Weights weights;
  Image<D> image1;
  Image<2> image2;

  template <class T, class Group>
  KV_HD Problem(Dlt<T> const& p, int64_t b, Group group)
      : weights(p.weights, b, p.count, p.model == DltModel::pose, group),
        image1{p.points1, b * p.stride, {}, {}, 0, 0},
        image2{p.points2, b * p.stride, {p.camera, 9 * b}, {}, 0, 0} {
    image1.template normalize<kPoints>(weights, kEps, group);
    image2.template normalize<kPoints>(weights, kEps, group);
  }
  KV_HD double fraction(int64_t i) const { return weights.fraction(i) / kPoints; }  // of one point of correspondence i
  // Sets the normalized points of both images, homogeneous with a last coordinate of 1.
  KV_HD void normalized(int64_t i, double* n1, double* n2) const {
    image1.centered(i, n1);
    image2.centered(i, n2);
    for (int k = 0; k < D; ++k) n1[k] *= image1.scale;
    for (int k = 0; k < 2; ++k) n2[k] *= image2.scale;
    n1[D] = n2[2] = 1;
  }
  // Sets m = h T1 for a matrix h of three rows.
  KV_HD void denormalize_right(double const* h, double* m) const {
    for (int r = 0; r < 3; ++r, h += kColumns, m += kColumns) {
      m[D] = h[D];
      for (int k = 0; k < D; ++k) m[k] = image1.scale * h[k], m[D] -= m[k] * image1.mean[k];
    }
  }
  // Turns the gradient g to h T1 into that to h, in place, and adds to the gradient of the first image.
  KV_HD void denormalize_right_vjp(double const* h, double* g, ImageGradients<D>& grad_image1) const {
    for (int r = 0; r < 3; ++r, h += kColumns, g += kColumns)
      for (int k = 0; k < D; ++k) {
        double const inner = g[k] - g[D] * image1.mean[k];
        grad_image1.scale += inner * h[k];
        grad_image1.mean[k] -= g[D] * image1.scale * h[k];
        g[k] = image1.scale * inner;
      }
  }
};

template <int C>
KV_HD double product(double const* a, double const* b) {
  double sum = 0;
  for (int k = 0; k < C; ++k) sum += a[k] * b[k];
  return sum;
}

// The index of entry (i, k) of a symmetric matrix that stores its lower triangle row by row.
KV_HD int packed_index(int i, int k) { return i > k ? i * (i + 1) / 2 + k : k * (k + 1) / 2 + i; }

// --- maps from points of D coordinates to the second image -----------------------------------------------------------

template <int D>
struct Projective {
  static constexpr int kAxes = D, kPoints = 1, C = D + 1, kUnknowns = 3 * C;

  // Sets M, in memory that the group shares. It has five different blocks, of which two are 0: sums of w, -w x, -w y
  // and w (x^2 + y^2) times n1 n1^T.
  template <class Group>
  static KV_CALLED void normal_matrix(Problem<D> const& problem, Group group, double* m) {
    constexpr int kSums = C * (C + 1) / 2;
    double sums[4 * kSums] = {};
    for (int64_t i = group.thread_rank(); i < problem.weights.count; i += group.num_threads()) {
      double n1[C], n2[3];
      problem.normalized(i, n1, n2);
      double const w = problem.weights[i];
      double const factors[] = {w, -w * n2[0], -w * n2[1], w * (n2[0] * n2[0] + n2[1] * n2[1])};
      for (int r = 0, at = 0; r < C; ++r)
        for (int c = 0; c <= r; ++c, ++at)
          for (int f = 0; f < 4; ++f) sums[f * kSums + at] += factors[f] * n1[r] * n1[c];
    }
    double const* const all = group.sums(sums);
    for (int row = group.thread_rank(); row < kUnknowns; row += group.num_threads()) {
      int const r = row / C, i = row % C;
      for (int c = 0; c < 3; ++c) {
        double const* const block = all + (r == c ? (r == 2 ? 3 : 0) : r + c - 1) * kSums;
        for (int k = 0; k < C; ++k)
          m[row * kUnknowns + c * C + k] = r != c && r + c == 1 ? 0 : block[packed_index(i, k)];
      }
    }
    group.sync();
  }

  // The gradient of -u^T (sum w r r^T) h to a correspondence: returns that to w, sets those to the normalized points.
  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double const x = n2[0], y = n2[1], square = x * x + y * y;
    double a[3], c[3];
    for (int k = 0; k < 3; ++k) a[k] = product<C>(u + C * k, n1), c[k] = product<C>(h + C * k, n1);
    double const cross_x = a[0] * c[2] + a[2] * c[0], cross_y = a[1] * c[2] + a[2] * c[1];
    g2[0] = -w * (2 * x * a[2] * c[2] - cross_x);
    g2[1] = -w * (2 * y * a[2] * c[2] - cross_y);
    double const grad_a[] = {c[0] - x * c[2], c[1] - y * c[2], square * c[2] - x * c[0] - y * c[1]};
    double const grad_c[] = {a[0] - x * a[2], a[1] - y * a[2], square * a[2] - x * a[0] - y * a[1]};
    for (int k = 0; k < D; ++k) {
      g1[k] = 0;
      for (int r = 0; r < 3; ++r) g1[k] -= w * (grad_a[r] * u[C * r + k] + grad_c[r] * h[C * r + k]);
    }
    return -(a[0] * c[0] + a[1] * c[1] + square * a[2] * c[2] - x * cross_x - y * cross_y);
  }

  // Constrains the eigenvector h to a valid model. Here every h is valid.
  static KV_HD void constrain(double const* h, double* f) {
    for (int i = 0; i < kUnknowns; ++i) f[i] = h[i];
  }
  static KV_HD void constrain_vjp(double const*, double*) {}

  // Sets m to T2^-1 times a matrix, up to scale.
  static KV_HD void denormalize_left(Image<2> const& image2, double const* denormalize_right, double* m) {
    double const* const last = denormalize_right + 2 * C;
    for (int k = 0; k < C; ++k) {
      for (int r = 0; r < 2; ++r) m[r * C + k] = denormalize_right[r * C + k] + image2.scale * image2.mean[r] * last[k];
      m[2 * C + k] = image2.scale * last[k];
    }
  }
  static KV_HD void denormalize_left_vjp(Image<2> const& image2, double const* denormalize_right, double* g,
                                         ImageGradients<2>& grad_image2) {
    double const* const last = denormalize_right + 2 * C;
    for (int k = 0; k < C; ++k) {
      for (int r = 0; r < 2; ++r) grad_image2.mean[r] += image2.scale * g[r * C + k] * last[k];
      double const by_scale = image2.mean[0] * g[k] + image2.mean[1] * g[C + k] + g[2 * C + k];
      grad_image2.scale += by_scale * last[k];
      g[2 * C + k] = image2.scale * by_scale;
    }
  }
};

// The number that a matrix is divided by: its last entry, or the largest magnitude where that entry is 0.
KV_HD double divisor(double const* m, bool& last) {
  double largest = 0;
  for (int i = 0; i < 9; ++i) largest = max(largest, small::magnitude(m[i]));
  last = small::magnitude(m[8]) > 1e-12 * largest;
  return last ? m[8] : largest > 0 ? largest : 1;
}

KV_HD void to_unit_last(double const* m, double* result) {
  bool last;
  double const scale = 1 / divisor(m, last);
  for (int i = 0; i < 9; ++i) result[i] = m[i] * scale;
}
KV_HD void to_unit_last_vjp(double const* m, double* g) {
  bool last;
  double const scale = 1 / divisor(m, last);
  double along = 0;
  for (int i = 0; i < 9; ++i) g[i] *= scale, along += g[i] * m[i] * scale;
  if (last) g[8] -= along;
}

struct Homography : Projective<2> {
  static constexpr int kOutputSize = 9;
  static KV_HD void finish(double const* m, double* result) { to_unit_last(m, result); }
  static KV_HD void finish_vjp(double const* m, double* g) { to_unit_last_vjp(m, g); }
  template <class T, class Group>
  static KV_HD bool is_solvable(Dlt<T> const&, Problem<2> const&, Group) {
    return true;
  }
};

// Sets m, in memory that the group shares, to the sum of w l l^T times n1 n1^T; each factor has six different entries.
// `pair` returns w and sets n1 and l, three numbers each, of a point.
template <class Group, class Pair>
KV_HD void sum_products(int64_t count, Group group, Pair pair, double* m) {
  double sums[36] = {};
  for (int64_t i = group.thread_rank(); i < count; i += group.num_threads()) {
    double n1[3], n2[3], products[6];
    double const w = pair(i, n1, n2);
    for (int r = 0, at = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++at) products[at] = n1[r] * n1[c];
    for (int r = 0, at = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++at)
        for (int k = 0; k < 6; ++k) sums[6 * at + k] += w * n2[r] * n2[c] * products[k];
  }
  double const* const all = group.sums(sums);
  for (int row = group.thread_rank(); row < 9; row += group.num_threads())
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < 3; ++k) m[9 * row + 3 * c + k] = all[6 * packed_index(row / 3, c) + packed_index(row % 3, k)];
  group.sync();
}

// --- homographies of segments, from their ends to lines --------------------------------------------------------------

struct Lines : Homography {
  static constexpr int kPoints = 2;

  template <class Group>
  static KV_CALLED void normal_matrix(Problem<2, 2> const& problem, Group group, double* m) {
    auto const end = [&](int64_t i, double* n1, double* line) KV_INLINE {
      double start[3], end[3], other[3];
      problem.normalized(i ^ 1, other, start);
      problem.normalized(i, n1, end);
      cross3(start, end, line);  // its sign does not matter
      return problem.weights[i / 2];
    };
    sum_products(2 * problem.weights.count, group, end, m);
  }
  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double line[3], grad_line[3] = {}, grad_ends[3], grad_weight = 0;
    cross3(n2, n2 + 3, line);
    for (int end = 0; end < 2; ++end) {
      double by_u[3], by_h[3];
      for (int r = 0; r < 3; ++r) by_u[r] = dot3(u + 3 * r, n1 + 3 * end), by_h[r] = dot3(h + 3 * r, n1 + 3 * end);
      double const a = dot3(by_u, line), c = dot3(by_h, line);
      grad_weight -= a * c;
      for (int k = 0; k < 3; ++k) grad_line[k] -= w * (c * by_u[k] + a * by_h[k]);
      for (int k = 0; k < 2; ++k) {
        g1[2 * end + k] = 0;
        for (int r = 0; r < 3; ++r) g1[2 * end + k] -= w * line[r] * (c * u[3 * r + k] + a * h[3 * r + k]);
      }
    }
    cross3(n2 + 3, grad_line, grad_ends);
    g2[0] = grad_ends[0], g2[1] = grad_ends[1];
    cross3(grad_line, n2, grad_ends);
    g2[2] = grad_ends[0], g2[3] = grad_ends[1];
    return grad_weight;
  }
  template <class T, class Group>
  static KV_HD bool is_solvable(Dlt<T> const&, Problem<2, 2> const&, Group) {
    return true;
  }
};

// --- poses -----------------------------------------------------------------------------------------------------------

// Turns a camera (3, 4) of any scale and sign into a pose: the columns of the rotation are made orthogonal one after
// the other.
struct GramSchmidt {
  double sign, size, along, second_size;
  double first[3], second[3], third[3], b[3], t[3];

  KV_HD static double nonzero(double x) { return x > 0 ? x : 1; }
  KV_HD explicit GramSchmidt(double const* m) {
    double a[3], c[3], ab[3];
    for (int i = 0; i < 3; ++i) a[i] = m[4 * i], b[i] = m[4 * i + 1], c[i] = m[4 * i + 2], t[i] = m[4 * i + 3];
    cross3(a, b, ab);
    sign = dot3(ab, c) < 0 ? -1 : 1;
    size = nonzero(sqrt(dot3(a, a)));
    for (int i = 0; i < 3; ++i) first[i] = sign * a[i] / size, b[i] *= sign, t[i] *= sign / size;
    along = dot3(first, b);
    for (int i = 0; i < 3; ++i) second[i] = b[i] - along * first[i];
    second_size = nonzero(sqrt(dot3(second, second)));
    for (double& x : second) x /= second_size;
    cross3(first, second, third);
  }
};

struct Pose : Projective<3> {
  static constexpr int kOutputSize = 12;

  static KV_CALLED void finish(double const* m, double* result) {
    GramSchmidt const r(m);
    for (int i = 0; i < 3; ++i)
      result[4 * i] = r.first[i], result[4 * i + 1] = r.second[i], result[4 * i + 2] = r.third[i],
                 result[4 * i + 3] = r.t[i];
  }
  static KV_CALLED void finish_vjp(double const* m, double* g) {
    GramSchmidt const r(m);
    double grad_first[3], grad_second[3], grad_third[3], grad_t[3], product[3];
    for (int i = 0; i < 3; ++i)
      grad_first[i] = g[4 * i], grad_second[i] = g[4 * i + 1], grad_third[i] = g[4 * i + 2], grad_t[i] = g[4 * i + 3];
    cross3(r.second, grad_third, product);
    for (int i = 0; i < 3; ++i) grad_first[i] += product[i];
    cross3(grad_third, r.first, product);
    for (int i = 0; i < 3; ++i) grad_second[i] += product[i];
    double const radial = dot3(r.second, grad_second);
    double grad_b[3];
    for (int i = 0; i < 3; ++i) grad_b[i] = (grad_second[i] - r.second[i] * radial) / r.second_size;
    double const grad_along = -dot3(grad_b, r.first);
    for (int i = 0; i < 3; ++i) {
      grad_first[i] += grad_along * r.b[i] - r.along * grad_b[i];
      grad_b[i] += grad_along * r.first[i];
    }
    double const spin = dot3(r.first, grad_first), stretch = dot3(r.t, grad_t);
    for (int i = 0; i < 3; ++i) {
      g[4 * i] = r.sign * (grad_first[i] - (spin + stretch) * r.first[i]) / r.size;
      g[4 * i + 1] = r.sign * grad_b[i];
      g[4 * i + 2] = 0;
      g[4 * i + 3] = r.sign * grad_t[i] / r.size;
    }
  }

  // Whether the points lie in no plane: decided by the smallest singular value of the normalized points, with weights
  // that are 1 on average.
  template <class T, class Group>
  static KV_CALLED bool is_solvable(Dlt<T> const& p, Problem<3> const& problem, Group group) {
    double sums[6] = {}, used = 0, m[9], copy[9], v[3];
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
      double at[3];
      problem.image1.centered(i, at);
      double const w = problem.weights[i];
      used += w > 0;
      for (int r = 0, to = 0; r < 3; ++r)
        for (int c = 0; c <= r; ++c, ++to) sums[to] += w * at[r] * at[c];
    }
    used = group.sum(used);
    double const mean = problem.weights.weights.data ? used / problem.weights.total : 1;
    double const scale = problem.image1.scale * problem.image1.scale * mean;
    for (int r = 0, from = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c, ++from) m[3 * r + c] = m[3 * c + r] = scale * group.sum(sums[from]);
    for (int i = 0; i < 9; ++i) copy[i] = m[i];
    small::smallest_eigenvector<3>(copy, v);
    double square = 0;
    for (int r = 0; r < 3; ++r) square += v[r] * dot3(m + 3 * r, v);
    return !(sqrt(square > 0 ? square : 0) < p.min_extent);
  }
};

// --- fundamental matrices --------------------------------------------------------------------------------------------

struct Fundamental {
  static constexpr int kAxes = 2, kPoints = 1, kUnknowns = 9, kOutputSize = 9;

  template <class Group>
  static KV_CALLED void normal_matrix(Problem<2> const& problem, Group group, double* m) {
    auto const pair = [&](int64_t i, double* n1, double* n2) KV_INLINE {
      problem.normalized(i, n1, n2);
      return problem.weights[i];
    };
    sum_products(problem.weights.count, group, pair, m);
  }

  static KV_HD double row_vjp(double w, double const* u, double const* h, double const* n1, double const* n2,
                              double* g1, double* g2) {
    double by_u[3], by_h[3];
    for (int r = 0; r < 3; ++r) by_u[r] = dot3(u + 3 * r, n1), by_h[r] = dot3(h + 3 * r, n1);
    double const a = dot3(by_u, n2), c = dot3(by_h, n2);
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
    small::project_to_rank_two(f, v);
  }
  // The gradient of F - F v v^T, where v is the eigenvector of the smallest eigenvalue of F^T F.
  static KV_CALLED void constrain_vjp(double const* h, double* g) {
    double f[9], v[3], square[9], grad_v[3], u[3], fv[3], gv[3], fu[3];
    for (int i = 0; i < 9; ++i) f[i] = h[i];
    if (!small::project_to_rank_two(f, v)) return;
    for (int r = 0; r < 3; ++r) fv[r] = dot3(h + 3 * r, v), gv[r] = dot3(g + 3 * r, v);
    for (int i = 0; i < 3; ++i) {
      grad_v[i] = 0;
      for (int r = 0; r < 3; ++r) grad_v[i] -= h[3 * r + i] * gv[r] + g[3 * r + i] * fv[r];
      for (int k = 0; k < 3; ++k) square[3 * i + k] = h[i] * h[k] + h[3 + i] * h[3 + k] + h[6 + i] * h[6 + k];
    }
    small::smallest_eigenvector_vjp<3>(square, v, grad_v, u);
    for (int r = 0; r < 3; ++r) fu[r] = dot3(h + 3 * r, u);
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 3; ++k) g[3 * r + k] -= gv[r] * v[k] + fu[r] * v[k] + fv[r] * u[k];
  }

  // Sets m to T2^T times a matrix.
  static KV_HD void denormalize_left(Image<2> const& image2, double const* denormalize_right, double* m) {
    for (int k = 0; k < 3; ++k) {
      for (int r = 0; r < 2; ++r) m[3 * r + k] = image2.scale * denormalize_right[3 * r + k];
      m[6 + k] = denormalize_right[6 + k] - m[k] * image2.mean[0] - m[3 + k] * image2.mean[1];
    }
  }
  static KV_HD void denormalize_left_vjp(Image<2> const& image2, double const* denormalize_right, double* g,
                                         ImageGradients<2>& grad_image2) {
    for (int k = 0; k < 3; ++k)
      for (int r = 0; r < 2; ++r) {
        double const inner = g[3 * r + k] - g[6 + k] * image2.mean[r];
        grad_image2.scale += inner * denormalize_right[3 * r + k];
        grad_image2.mean[r] -= g[6 + k] * image2.scale * denormalize_right[3 * r + k];
        g[3 * r + k] = image2.scale * inner;
      }
  }
  static KV_HD void finish(double const* m, double* result) { to_unit_last(m, result); }
  static KV_HD void finish_vjp(double const* m, double* g) { to_unit_last_vjp(m, g); }
  template <class T, class Group>
  static KV_HD bool is_solvable(Dlt<T> const&, Problem<2> const&, Group) {
    return true;
  }
};

// --- affine maps -----------------------------------------------------------------------------------------------------

struct Affine {};

struct AffineFit {
  double inverse_covariance[4], cross_covariance[4], linear[4];  // of S = sum w x x^T; C = sum w x y^T; A = (S^-1 C)^T
  bool is_singular;

  template <class Group>
  KV_HD AffineFit(Problem<2> const& problem, Group group) {
    double sums[7] = {};
    for (int64_t i = group.thread_rank(); i < problem.weights.count; i += group.num_threads()) {
      double x[2], y[2];
      problem.image1.centered(i, x);
      problem.image2.centered(i, y);
      double const w = problem.weights.fraction(i);
      sums[0] += w * x[0] * x[0], sums[1] += w * x[0] * x[1], sums[2] += w * x[1] * x[1];
      for (int k = 0; k < 4; ++k) sums[3 + k] += w * x[k / 2] * y[k % 2];
    }
    for (double& sum : sums) sum = group.sum(sum);
    double const trace = sums[0] + sums[2], area = sums[0] * sums[2] - sums[1] * sums[1];
    is_singular = !(area > 1e-12 * trace * trace);
    inverse_covariance[0] = sums[2] / area, inverse_covariance[3] = sums[0] / area;
    inverse_covariance[1] = inverse_covariance[2] = -sums[1] / area;
    for (int k = 0; k < 4; ++k) cross_covariance[k] = sums[3 + k];
    for (int r = 0; r < 2; ++r)
      for (int c = 0; c < 2; ++c)
        linear[2 * r + c] =
            inverse_covariance[2 * c] * cross_covariance[r] + inverse_covariance[2 * c + 1] * cross_covariance[2 + r];
  }
};

}  // namespace dlt_models

template <class Model, class T, class Group>
KV_HD void solve_dlt(Model, Dlt<T> const& p, int64_t b, Group group) {
  constexpr int n = Model::kUnknowns;
  dlt_models::Problem<Model::kAxes, Model::kPoints> const problem(p, b, group);
  typename Group::template SharedStorage<small::EigenSpace<n>> storage;
  small::EigenSpace<n>& space = storage.get();
  bool const is_solvable = Model::is_solvable(p, problem, group);
  Model::normal_matrix(problem, group, space.matrix);
  auto const warp = group.first_warp();
  if (warp.is_idle()) return;
  small::smallest_eigenvector<n>(space, warp);
  if (group.thread_rank() != 0) return;
  double f[n], denormalize_right[n], result[n];
  Model::constrain(space.v, f);
  problem.denormalize_right(f, denormalize_right);
  Model::denormalize_left(problem.image2, denormalize_right, f);
  Model::finish(f, result);
  for (int i = 0; i < n; ++i) p.result.set(n * b + i, is_solvable ? result[i] : small::nan());
}

template <class Model, class T, class Group>
KV_HD void solve_dlt_vjp(Model, Dlt<T> const& p, int64_t b, Group group) {
  constexpr int n = Model::kUnknowns, D = Model::kAxes, kPoints = Model::kPoints;
  dlt_models::Problem<D, kPoints> const problem(p, b, group);
  dlt_models::Image<D> const& image1 = problem.image1;
  dlt_models::Image<2> const& image2 = problem.image2;
  dlt_models::ImageGradients<D> grad_image1;
  dlt_models::ImageGradients<2> grad_image2;
  dlt_models::Weights const& weights = problem.weights;
  typename Group::template SharedStorage<small::EigenSpace<n>> storage;
  small::EigenSpace<n>& space = storage.get();
  double const *const h = space.v, *const u = space.u;
  bool const is_solvable = Model::is_solvable(p, problem, group);
  Model::normal_matrix(problem, group, space.matrix);
  auto const warp = group.first_warp();
  if (!warp.is_idle()) small::smallest_eigenvector<n>(space, warp);
  if (group.thread_rank() == 0) {
    double f[n], denormalize_right[n], denormalize_left[n], g[n];
    Model::constrain(h, f);
    problem.denormalize_right(f, denormalize_right);
    Model::denormalize_left(image2, denormalize_right, denormalize_left);
    for (int i = 0; i < n; ++i) g[i] = is_solvable ? p.grad[n * b + i] : 0;
    Model::finish_vjp(denormalize_left, g);
    Model::denormalize_left_vjp(image2, denormalize_right, g, grad_image2);
    problem.denormalize_right_vjp(f, g, grad_image1);
    Model::constrain_vjp(h, g);
    for (int i = 0; i < n; ++i) space.g[i] = g[i];
  }
  if (!warp.is_idle()) {
    warp.sync();
    small::smallest_eigenvector_vjp<n>(space, warp);
  }
  group.sync();

  // Sets the gradients to the normalized points of correspondence i, and returns that to its weight.
  auto const row_gradients = [&](int64_t i, double* g1, double* g2) KV_INLINE {
    double n1[kPoints * (D + 1)], n2[kPoints * 3];
    for (int e = 0; e < kPoints; ++e) problem.normalized(kPoints * i + e, n1 + (D + 1) * e, n2 + 3 * e);
    return Model::row_vjp(weights[i], u, h, n1, n2, g1, g2);
  };
  double g1[kPoints * D], g2[kPoints * 2];
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    row_gradients(i, g1, g2);
    for (int e = 0; e < kPoints; ++e) {
      grad_image1.add(image1, kPoints * i + e, problem.fraction(i), g1 + D * e);
      grad_image2.add(image2, kPoints * i + e, problem.fraction(i), g2 + 2 * e);
    }
  }
  grad_image1.finish(image1, group);
  grad_image2.finish(image2, group);

  // Gradients to points and to fractions; the fractions sum to 1.
  double mean_grad = 0, grad_camera[6] = {};
  auto const grad_fraction = [&](int64_t i) KV_INLINE {
    double sum = 0;
    for (int64_t e = kPoints * i; e < kPoints * (i + 1); ++e)
      sum += grad_image1.grad_fraction(image1, e) + grad_image2.grad_fraction(image2, e);
    return sum / kPoints;
  };
  if (weights.is_weighted()) {
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads())
      mean_grad += weights.fraction(i) * grad_fraction(i);
    mean_grad = group.sum(mean_grad);
  }
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double grad_weight = row_gradients(i, g1, g2);
    for (int e = 0; e < kPoints; ++e) {
      grad_image1.grad_point(image1, kPoints * i + e, problem.fraction(i), g1 + D * e);
      grad_image2.grad_point(image2, kPoints * i + e, problem.fraction(i), g2 + 2 * e);
    }
    if (weights.is_weighted() && weights[i] >= 0) grad_weight += (grad_fraction(i) - mean_grad) / weights.total;
    if (weights.squared && weights.weights.data) grad_weight *= 2 * weights.weights[weights.first + i];
    if (image2.calibration.camera.data) {
      double pixel[2], xy[2];
      image2.point(i, xy);
      for (int k = 0; k < 2; ++k) pixel[k] = image2.points[2 * (image2.start + i) + k];
      image2.calibration.vjp(pixel, xy, g2, grad_camera);
    }
    for (int k = 0; k < kPoints * D; ++k) p.grad_points1.set(D * (image1.start + kPoints * i) + k, g1[k]);
    for (int k = 0; k < kPoints * 2; ++k) p.grad_points2.set(2 * (image2.start + kPoints * i) + k, g2[k]);
    p.grad_weights.set(b * p.count + i, grad_weight);
  }
  if (!image2.calibration.camera.data) return;
  constexpr int entries[] = {0, 1, 2, 4, 5, 8};
  for (double& x : grad_camera) x = group.sum(x);
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 9; ++i) p.grad_camera.set(9 * b + i, 0);
  for (int i = 0; i < 6; ++i) p.grad_camera.set(9 * b + entries[i], grad_camera[i]);
}

template <class T, class Group>
KV_HD void solve_dlt(dlt_models::Affine, Dlt<T> const& p, int64_t b, Group group) {
  dlt_models::Problem<2> const problem(p, b, group);
  dlt_models::AffineFit const map(problem, group);
  if (group.thread_rank() != 0) return;
  for (int r = 0; r < 2; ++r) {
    double const *const row = map.linear + 2 * r, *const mean = problem.image1.mean;
    double const result[] = {row[0], row[1], problem.image2.mean[r] - row[0] * mean[0] - row[1] * mean[1]};
    for (int k = 0; k < 3; ++k) p.result.set(9 * b + 3 * r + k, map.is_singular ? small::nan() : result[k]);
  }
  for (int k = 0; k < 3; ++k) p.result.set(9 * b + 6 + k, k == 2);
}

template <class T, class Group>
KV_HD void solve_dlt_vjp(dlt_models::Affine, Dlt<T> const& p, int64_t b, Group group) {
  dlt_models::Problem<2> const problem(p, b, group);
  dlt_models::AffineFit const map(problem, group);
  dlt_models::Weights const& weights = problem.weights;
  // Gradients to S, to C and to both means.
  double grad_map[4], grad_across[4], grad_square[4], grad_mean1[2] = {}, grad_mean2[2];
  for (int r = 0; r < 2; ++r) {
    double const shift = map.is_singular ? 0 : p.grad[9 * b + 3 * r + 2];
    grad_mean2[r] = shift;
    for (int c = 0; c < 2; ++c) {
      grad_mean1[c] -= map.is_singular ? 0 : shift * map.linear[2 * r + c];
      grad_map[2 * r + c] = map.is_singular ? 0 : p.grad[9 * b + 3 * r + c] - shift * problem.image1.mean[c];
    }
  }
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k)
      grad_across[2 * i + k] = map.is_singular ? 0
                                               : map.inverse_covariance[2 * i] * grad_map[2 * k] +
                                                     map.inverse_covariance[2 * i + 1] * grad_map[2 * k + 1];
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 2; ++k)
      grad_square[2 * i + k] =
          map.is_singular ? 0 : -(grad_across[2 * i] * map.linear[k] + grad_across[2 * i + 1] * map.linear[2 + k]);

  // Of a correspondence: sets the gradients to both points, divided by its fraction, and returns that to the fraction.
  auto const row_gradients = [&](int64_t i, double* g1, double* g2) KV_INLINE {
    double x[2], y[2], grad_fraction = 0;
    problem.image1.centered(i, x);
    problem.image2.centered(i, y);
    for (int k = 0; k < 2; ++k) {
      double const by_square = grad_square[2 * k] * x[0] + grad_square[2 * k + 1] * x[1];
      double const by_across = grad_across[2 * k] * y[0] + grad_across[2 * k + 1] * y[1];
      grad_fraction += x[k] * (by_square + by_across);
      g1[k] = by_square + grad_square[k] * x[0] + grad_square[2 + k] * x[1] + by_across + grad_mean1[k];
      g2[k] = grad_across[k] * x[0] + grad_across[2 + k] * x[1] + grad_mean2[k];
      grad_fraction +=
          grad_mean1[k] * (x[k] + problem.image1.mean[k]) + grad_mean2[k] * (y[k] + problem.image2.mean[k]);
    }
    return grad_fraction;
  };
  double mean_grad = 0, g1[2], g2[2];
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads())
    mean_grad += weights.fraction(i) * row_gradients(i, g1, g2);
  mean_grad = group.sum(mean_grad);
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double const grad_fraction = row_gradients(i, g1, g2), fraction = weights.fraction(i);
    for (int k = 0; k < 2; ++k) {
      p.grad_points1.set(2 * (problem.image1.start + i) + k, fraction * g1[k]);
      p.grad_points2.set(2 * (problem.image2.start + i) + k, fraction * g2[k]);
    }
    bool const counts = weights.is_weighted() && weights[i] >= 0;
    p.grad_weights.set(b * p.count + i, counts ? (grad_fraction - mean_grad) / weights.total : 0);
  }
}

template <class T, class Group>
KV_HD void normalize_problem(NormalizedPoints<T> const& p, int64_t b, Group group) {
  dlt_models::Weights const weights(p.weights, b, p.count, false, group);
  dlt_models::Image<2> image{p.points, b * p.count, {}, {}, 0, 0};
  image.normalize<1>(weights, p.eps, group);
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double at[2];
    image.centered(i, at);
    for (int k = 0; k < 2; ++k) p.normalized.set(2 * (image.start + i) + k, image.scale * at[k]);
  }
  if (group.thread_rank() != 0) return;
  for (int i = 0; i < 9; ++i) {
    double const shift = i % 3 == 2 && i < 6 ? -image.scale * image.mean[i / 3] : 0;
    p.matrix.set(9 * b + i, i == 8 ? 1 : i % 4 == 0 ? image.scale : shift);
  }
}

template <class T, class Group>
KV_HD void normalize_problem_vjp(NormalizedPoints<T> const& p, int64_t b, Group group) {
  dlt_models::Weights const weights(p.weights, b, p.count, false, group);
  dlt_models::Image<2> image{p.points, b * p.count, {}, {}, 0, 0};
  image.normalize<1>(weights, p.eps, group);
  dlt_models::ImageGradients<2> gradients;
  auto const read_grad = [&](int64_t i, double* g) KV_INLINE {
    for (int k = 0; k < 2; ++k) g[k] = p.grad[2 * (image.start + i) + k];
  };
  double g[2], mean_grad = 0;
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    read_grad(i, g);
    gradients.add(image, i, weights.fraction(i), g);
  }
  if (group.thread_rank() == 0)
    for (int k = 0; k < 2; ++k) {
      double const shift = p.grad_matrix[9 * b + 3 * k + 2];
      gradients.scale += p.grad_matrix[9 * b + 4 * k] - shift * image.mean[k];
      gradients.mean[k] -= shift * image.scale;
    }
  gradients.finish(image, group);
  if (weights.is_weighted()) {
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads())
      mean_grad += weights.fraction(i) * gradients.grad_fraction(image, i);
    mean_grad = group.sum(mean_grad);
  }
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    read_grad(i, g);
    gradients.grad_point(image, i, weights.fraction(i), g);
    for (int k = 0; k < 2; ++k) p.grad_points.set(2 * (image.start + i) + k, g[k]);
    bool const counts = weights.is_weighted() && weights[i] >= 0;
    p.grad_weights.set(b * p.count + i, counts ? (gradients.grad_fraction(image, i) - mean_grad) / weights.total : 0);
  }
}

// Calls f with the functions of a model.
template <class F>
KV_HD void dispatch_model(DltModel model, F f) {
  switch (model) {
    case DltModel::homography:
      return f(dlt_models::Homography{});
    case DltModel::lines:
      return f(dlt_models::Lines{});
    case DltModel::fundamental:
      return f(dlt_models::Fundamental{});
    case DltModel::pose:
      return f(dlt_models::Pose{});
    default:
      return f(dlt_models::Affine{});
  }
}

}  // namespace kv::geometry
