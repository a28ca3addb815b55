// Direct linear transformation (DLT), see dlt.h: the parameters of the kernels, weights and images of a problem, the
// normalization of points and its gradient.
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

// Normalizes points alone, as dlt.h says, and returns the matrix of the normalization.
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
  // Converts the gradient g to (x, y) into that to the pixel p, and adds that to K's six entries to `sums`.
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
  // Converts the gradient g to h T1 into that to h, in place, and adds to the gradient of the first image.
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

}  // namespace dlt_models

}  // namespace kv::geometry
