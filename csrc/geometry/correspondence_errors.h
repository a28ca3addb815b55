// Errors of correspondences under the matrix that relates two images, and their gradients to both points and to it.
//
//   sampson              of a fundamental matrix: r^2 / (a + b), for the residual r and the squared lengths a, b of
//                        the normals of the epipolar lines in the second and the first image
//   symmetrical          r^2 / a + r^2 / b
//   right, left          |r| / sqrt(a), |r| / sqrt(b): the distance from the epipolar line in one image
//   transfer             of a homography: the squared distance of the mapped point from its correspondence
//   symmetric_transfer   transfer plus that of the inverse from the second image to the first
//   sampson_transfer     the squared distance of both points from the nearest exact correspondence, to first order
//   segments             the mean distance of a mapped segment's ends from the line of the other segment
//
// Computes in double. Sums over correspondences are those of chunks, then of all chunks.
#pragma once

#include "core/isa.h"
#include "geometry/residuals.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

enum class ErrorKind : int {
  sampson,
  symmetrical,
  right,
  left,
  transfer,
  symmetric_transfer,
  sampson_transfer,
  segments
};

template <class T>
struct CorrespondenceErrors {
  Reals points1, points2, matrix;           // (B, N, 2, 3 or 4), (B, 3, 3)
  int axes1, axes2;                         // coordinates of a point
  int64_t stride1, stride2, matrix_stride;  // batch strides, 0 if all problems share one
  int64_t batch, count, chunk_size;         // chunk_size: correspondences of a chunk
  ErrorKind kind;
  bool squared;
  double rounding, largest;  // rounding: eps of the type; largest: the error if a homography has no inverse
  Reals errors;              // (B, N)
  // For the gradient only:
  Reals grad, grad_points1, grad_points2, chunk_sums,
      grad_matrix;  // (B, N), (B, N, .), (B, N, .), (B, chunks, 9), (B, 9)

  KV_HD int64_t num_chunks() const { return (count + chunk_size - 1) / chunk_size; }
};

KV_KERNEL(correspondence_errors, CorrespondenceErrors)
KV_KERNEL(correspondence_errors_backward, CorrespondenceErrors)
KV_KERNEL(correspondence_errors_sums, CorrespondenceErrors)

namespace small {

KV_HD double infinity() { return __builtin_inf(); }

// The matrix of a problem, and the error of a correspondence under it.
struct ErrorModel {
  ErrorKind kind;
  bool squared, singular, homogeneous;
  double largest, scale;
  double m[9],
      inverse[9];  // m: the matrix over `scale`, which sampson_transfer does not depend on; inverse: a multiple of the
                   // inverse

  template <class T>
  KV_HD ErrorModel(CorrespondenceErrors<T> const& p, int64_t b)
      : kind(p.kind),
        squared(p.squared),
        singular(false),
        homogeneous(p.kind < ErrorKind::transfer),
        largest(p.largest),
        scale(1) {
    for (int i = 0; i < 9; ++i) m[i] = p.matrix[b * p.matrix_stride + i];
    if (kind == ErrorKind::sampson_transfer) {
      double largest_entry = 0;
      for (double x : m) largest_entry = max(largest_entry, magnitude(x));
      if (largest_entry > 0) scale = largest_entry;
      for (double& x : m) x /= scale;
    }
    if (kind != ErrorKind::symmetric_transfer) return;
    double rows[9];
    cofactors3(m, rows);
    for (int i = 0; i < 9; ++i) inverse[i] = rows[3 * (i % 3) + i / 3];
    double sides = 1;
    for (int i = 0; i < 9; i += 3) sides *= sqrt(dot3(m + i, m + i));
    singular = !(magnitude(dot3(m, rows)) > p.rounding * sides);
  }

  // Reads a point. Homogeneous points of homographies are divided by their last coordinate; false if that is 0.
  KV_HD bool read(Reals const& points, int axes, int64_t at, double* x) const {
    x[2] = 1;
    for (int k = 0; k < axes; ++k) x[k] = points[at + k];
    if (homogeneous || axes != 3) return true;
    if (x[2] == 0) return false;
    x[0] /= x[2], x[1] /= x[2];
    return true;
  }
  KV_HD void write(Reals const& to, int axes, int64_t at, double const* x, double* g) const {
    if (!homogeneous && axes == 3) {
      g[2] = -(g[0] * x[0] + g[1] * x[1]) / x[2];
      g[0] /= x[2], g[1] /= x[2];
    }
    for (int k = 0; k < axes; ++k) to.set(at + k, g[k]);
  }

  static KV_HD double divide(double a, double b) { return b == 0 ? infinity() : a / b; }
  static KV_HD double transfer(double const* m, double const* x, double const* y) {
    Mapped<double, double> const h(m, x[0], x[1]);
    return h.w == 0 ? infinity() : transfer_error(m, x[0], x[1], y[0], y[1]);
  }
  static KV_HD double length(double const* ends) {
    double const x = ends[2] - ends[0], y = ends[3] - ends[1];
    return sqrt(x * x + y * y);
  }
  // The squared error for kinds that are sums of squares, the error for the others.
  KV_HD double value(double const* x, double const* y) const {
    if (homogeneous) {
      Epipolar<double, double> const l(m, x[0], x[1], x[2], y[0], y[1], y[2]);
      double const square = l.r * l.r, second = l.second(), first = l.first();
      if (kind == ErrorKind::sampson) return divide(square, second + first);
      if (kind == ErrorKind::symmetrical) return divide(square, second) + divide(square, first);
      return divide(magnitude(l.r), sqrt(kind == ErrorKind::right ? second : first));
    }
    if (kind == ErrorKind::transfer) return transfer(m, x, y);
    if (kind == ErrorKind::symmetric_transfer) return transfer(m, x, y) + transfer(inverse, y, x);
    if (kind == ErrorKind::sampson_transfer) {
      SampsonTransfer const transfer_error_model(m, x, y);
      return transfer_error_model.volume() == 0 ? infinity() : transfer_error_model.error();
    }
    double const size = length(y);
    if (size == 0) return 0;
    double sum = 0;
    for (int end = 0; end < 4; end += 2) {
      bool const is_finite = Mapped<double, double>(m, x[end], x[end + 1]).w != 0;
      sum += is_finite ? line_error(m, x[end], x[end + 1], y[0], y[1], y[2], y[3]) : infinity();
    }
    return sum / (2 * size);
  }
  KV_HD bool is_sum_of_squares() const {
    return kind != ErrorKind::right && kind != ErrorKind::left && kind != ErrorKind::segments;
  }
  KV_HD double error(double const* x, double const* y) const {
    if (singular) return largest;
    double const error_value = value(x, y);
    return squared == is_sum_of_squares() || kind == ErrorKind::right || kind == ErrorKind::left ? error_value
           : squared ? error_value * error_value
                     : sqrt(error_value);
  }

  // Adds to the gradients, from the gradient g to the error.
  KV_HD void vjp(double const* x, double const* y, double g, double* grad_x, double* grad_y, double* grad_m,
                 double* grad_back) const {
    if (singular) return;
    if (kind == ErrorKind::segments) {
      double const size = length(y), error_value = value(x, y);
      if (size == 0 || !(error_value < infinity())) return;
      if (squared) g *= 2 * error_value;
      for (int end = 0; end < 4; end += 2) {
        double const offset = line_offset(m, x[end], x[end + 1], y[0], y[1], y[2], y[3]);
        double const side = offset > 0 ? 1 : offset < 0 ? -1 : 0;
        line_offset_vjp(m, x + end, y, g * side / (2 * size), grad_x + end, grad_y, grad_m);
      }
      for (int k = 0; k < 2; ++k) {
        double const grad_length = g * error_value * (y[2 + k] - y[k]) / (size * size);
        grad_y[k] += grad_length, grad_y[2 + k] -= grad_length;
      }
      return;
    }
    if (is_sum_of_squares() && !squared) {  // through the square root, whose gradient at 0 is taken as 0
      double const error_value = value(x, y);
      if (!(error_value > 0) || error_value == infinity()) return;
      g /= 2 * sqrt(error_value);
    }
    if (homogeneous) {
      Epipolar<double, double> const l(m, x[0], x[1], x[2], y[0], y[1], y[2]);
      double const second = l.second(), first = l.first();
      double grad_r = 0, grad_second = 0, grad_first = 0;
      if (kind == ErrorKind::sampson) {
        double const both = second + first;
        if (both != 0) grad_r = 2 * g * l.r / both, grad_second = grad_first = -g * l.r * l.r / (both * both);
      } else {
        auto const add = [&](double square, double& grad_square) {
          if (square == 0) return;
          if (kind == ErrorKind::symmetrical) {
            grad_r += 2 * g * l.r / square;
            grad_square -= g * l.r * l.r / (square * square);
          } else {
            double const size = sqrt(square);
            grad_r += g * (l.r > 0 ? 1 : l.r < 0 ? -1 : 0) / size;
            grad_square -= g * magnitude(l.r) / (2 * square * size);
          }
        };
        if (kind != ErrorKind::left) add(second, grad_second);
        if (kind != ErrorKind::right) add(first, grad_first);
      }
      epipolar_vjp(m, x, y, grad_r, grad_second, grad_first, grad_x, grad_y, grad_m);
      return;
    }
    if (kind == ErrorKind::sampson_transfer) {
      SampsonTransfer const transfer_error_model(m, x, y);
      if (transfer_error_model.volume() > 0) transfer_error_model.vjp(m, x, y, g, grad_x, grad_y, grad_m);
      return;
    }
    if (Mapped<double, double>(m, x[0], x[1]).w != 0) transfer_error_vjp(m, x, y, g, grad_x, grad_y, grad_m);
    if (kind == ErrorKind::symmetric_transfer && Mapped<double, double>(inverse, y[0], y[1]).w != 0)
      transfer_error_vjp(inverse, y, x, g, grad_y, grad_x, grad_back);
  }
};

}  // namespace small

template <class T>
KV_HD void set_error(CorrespondenceErrors<T> const& p, small::ErrorModel const& model, int64_t b, int64_t i) {
  double x[4], y[4];
  bool const is_finite1 = model.read(p.points1, p.axes1, b * p.stride1 + i * p.axes1, x);
  bool const is_finite2 = model.read(p.points2, p.axes2, b * p.stride2 + i * p.axes2, y);
  p.errors.set(b * p.count + i, is_finite1 && is_finite2 ? model.error(x, y) : small::infinity());
}

// The gradients of a chunk of a problem's correspondences.
template <class T, class Group>
KV_HD void differentiate_chunk(CorrespondenceErrors<T> const& p, int64_t chunk, Group group) {
  int64_t const num_chunks = p.num_chunks(), b = chunk / num_chunks, begin = (chunk - b * num_chunks) * p.chunk_size;
  int64_t const end = min(begin + p.chunk_size, p.count);
  small::ErrorModel const model(p, b);
  double grad_m[9] = {}, grad_back[9] = {};
  for (int64_t i = begin + group.thread_rank(); i < end; i += group.num_threads()) {
    double x[4], y[4], grad_x[4] = {}, grad_y[4] = {};
    bool const is_finite1 = model.read(p.points1, p.axes1, b * p.stride1 + i * p.axes1, x);
    bool const is_finite2 = model.read(p.points2, p.axes2, b * p.stride2 + i * p.axes2, y);
    if (is_finite1 && is_finite2) model.vjp(x, y, p.grad[b * p.count + i], grad_x, grad_y, grad_m, grad_back);
    if (!is_finite1) x[2] = 1;
    if (!is_finite2) y[2] = 1;
    model.write(p.grad_points1, p.axes1, (b * p.count + i) * p.axes1, x, grad_x);
    model.write(p.grad_points2, p.axes2, (b * p.count + i) * p.axes2, y, grad_y);
  }
  for (double& sum : grad_m) sum = group.sum(sum) / model.scale;
  if (model.kind == ErrorKind::symmetric_transfer) {
    double rows[9], grad_row[3];
    for (double& sum : grad_back) sum = group.sum(sum);
    for (int i = 0; i < 9; ++i) rows[i] = grad_back[3 * (i % 3) + i / 3];
    for (int r = 0; r < 3; ++r) {  // row r of the cofactors is the cross product of the two rows after it
      double const *const g = rows + 3 * r, *const one = model.m + 3 * ((r + 1) % 3),
                          *const two = model.m + 3 * ((r + 2) % 3);
      cross3(two, g, grad_row);
      for (int k = 0; k < 3; ++k) grad_m[3 * ((r + 1) % 3) + k] += grad_row[k];
      cross3(g, one, grad_row);
      for (int k = 0; k < 3; ++k) grad_m[3 * ((r + 2) % 3) + k] += grad_row[k];
    }
  }
  if (group.thread_rank() == 0)
    for (int i = 0; i < 9; ++i) p.chunk_sums.set(9 * chunk + i, grad_m[i]);
}

template <class T>
KV_HD void sum_error_chunks(CorrespondenceErrors<T> const& p, int64_t b, int k) {
  double sum = 0;
  for (int64_t chunk = 0; chunk < p.num_chunks(); ++chunk) sum += p.chunk_sums[9 * (b * p.num_chunks() + chunk) + k];
  p.grad_matrix.set(9 * b + k, sum);
}

}  // namespace kv::geometry
