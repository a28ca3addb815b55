// How far correspondences are from matrices, and the gradients to both points and to the matrix.
//
//   sampson, symmetrical     of a fundamental matrix: r^2 / (a + b), r^2 / a + r^2 / b for the residual r and the
//   squares
//                            a, b of its lines in both images
//   right, left              |r| / sqrt(a), |r| / sqrt(b)
//   transfer                 of a homography: the squared distance of where the point goes
//   symmetric_transfer       and of where its inverse takes the other one
//   sampson_transfer         how far both points are from the nearest ones that fit, to first order
//   segments                 the mean distance of both ends from the other segment's line
//
// Sums over correspondences are those of parts, then of all. In double. Included by correspondence_errors_cpu.cpp,
// correspondence_errors.cu and correspondence_errors_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/residuals.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv {

enum class ViewError : int {
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
struct ViewErrors {
  Reals points1, points2, matrix;              // (B, N, 2, 3 or 4), (B, 3, 3)
  int axes1, axes2;                            // numbers of a point
  int64_t problem1, problem2, problem_matrix;  // strides of B, 0 where one serves all
  int64_t batch, count, part;                  // part: correspondences that are summed first
  ViewError kind;
  bool squared;
  double rounding, largest;  // of the type: its eps, and the error of a homography without an inverse
  Reals errors;              // (B, N)
  // For the gradient only:
  Reals grad, to1, to2, parts, to_matrix;  // (B, N), (B, N, .), (B, N, .), (B, parts, 9), (B, 9)

  KV_HD int64_t part_count() const { return (count + part - 1) / part; }
};

KV_KERNEL(view_errors, ViewErrors)
KV_KERNEL(view_errors_backward, ViewErrors)
KV_KERNEL(view_errors_sums, ViewErrors)

namespace small {

KV_HD double infinity() { return __builtin_inf(); }

// What relates the images of a problem, and a correspondence's error by it.
struct Relation {
  ViewError kind;
  bool squared, singular, homogeneous;
  double largest, scale;
  double m[9], back[9];  // the matrix over its scale, which Sampson's distance does not have; a multiple of the inverse

  template <class T>
  KV_HD Relation(ViewErrors<T> const& p, int64_t b)
      : kind(p.kind),
        squared(p.squared),
        singular(false),
        homogeneous(p.kind < ViewError::transfer),
        largest(p.largest),
        scale(1) {
    for (int i = 0; i < 9; ++i) m[i] = p.matrix[b * p.problem_matrix + i];
    if (kind == ViewError::sampson_transfer) {
      double most = 0;
      for (double x : m) most = max(most, magnitude(x));
      if (most > 0) scale = most;
      for (double& x : m) x /= scale;
    }
    if (kind != ViewError::symmetric_transfer) return;
    double rows[9];
    cofactors(m, rows);
    for (int i = 0; i < 9; ++i) back[i] = rows[3 * (i % 3) + i / 3];
    double sides = 1;
    for (int i = 0; i < 9; i += 3) sides *= sqrt(dot3(m + i, m + i));
    singular = !(magnitude(dot3(m, rows)) > p.rounding * sides);
  }

  // A point as it is given, homogeneous ones of homographies by their last number.
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

  static KV_HD double over(double a, double b) { return b == 0 ? infinity() : a / b; }
  static KV_HD double transfer(double const* m, double const* x, double const* y) {
    Mapped<double, double> const h(m, x[0], x[1]);
    return h.w == 0 ? infinity() : transfer_error(m, x[0], x[1], y[0], y[1]);
  }
  static KV_HD double length(double const* ends) {
    double const x = ends[2] - ends[0], y = ends[3] - ends[1];
    return sqrt(x * x + y * y);
  }
  // Its square where that is a sum of squares, else as it is.
  KV_HD double value(double const* x, double const* y) const {
    if (homogeneous) {
      Epipolar<double, double> const l(m, x[0], x[1], x[2], y[0], y[1], y[2]);
      double const square = l.r * l.r, second = l.second(), first = l.first();
      if (kind == ViewError::sampson) return over(square, second + first);
      if (kind == ViewError::symmetrical) return over(square, second) + over(square, first);
      return over(magnitude(l.r), sqrt(kind == ViewError::right ? second : first));
    }
    if (kind == ViewError::transfer) return transfer(m, x, y);
    if (kind == ViewError::symmetric_transfer) return transfer(m, x, y) + transfer(back, y, x);
    if (kind == ViewError::sampson_transfer) {
      SampsonTransfer const found(m, x, y);
      return found.volume() == 0 ? infinity() : found.error();
    }
    double const size = length(y);
    if (size == 0) return 0;
    double sum = 0;
    for (int end = 0; end < 4; end += 2) {
      bool const there = Mapped<double, double>(m, x[end], x[end + 1]).w != 0;
      sum += there ? line_error(m, x[end], x[end + 1], y[0], y[1], y[2], y[3]) : infinity();
    }
    return sum / (2 * size);
  }
  KV_HD bool of_squares() const {
    return kind != ViewError::right && kind != ViewError::left && kind != ViewError::segments;
  }
  KV_HD double error(double const* x, double const* y) const {
    if (singular) return largest;
    double const found = value(x, y);
    return squared == of_squares() || kind == ViewError::right || kind == ViewError::left ? found
           : squared                                                                      ? found * found
                                                                                          : sqrt(found);
  }

  // From the gradient g to the error.
  KV_HD void vjp(double const* x, double const* y, double g, double* to_x, double* to_y, double* to_m,
                 double* to_back) const {
    if (singular) return;
    if (kind == ViewError::segments) {
      double const size = length(y), found = value(x, y);
      if (size == 0 || !(found < infinity())) return;
      if (squared) g *= 2 * found;
      for (int end = 0; end < 4; end += 2) {
        double const offset = line_offset(m, x[end], x[end + 1], y[0], y[1], y[2], y[3]);
        double const side = offset > 0 ? 1 : offset < 0 ? -1 : 0;
        line_offset_vjp(m, x + end, y, g * side / (2 * size), to_x + end, to_y, to_m);
      }
      for (int k = 0; k < 2; ++k) {
        double const shrink = g * found * (y[2 + k] - y[k]) / (size * size);
        to_y[k] += shrink, to_y[2 + k] -= shrink;
      }
      return;
    }
    if (of_squares() && !squared) {  // through the root, which has no slope at 0
      double const found = value(x, y);
      if (!(found > 0) || found == infinity()) return;
      g /= 2 * sqrt(found);
    }
    if (homogeneous) {
      Epipolar<double, double> const l(m, x[0], x[1], x[2], y[0], y[1], y[2]);
      double const second = l.second(), first = l.first();
      double to_r = 0, to_second = 0, to_first = 0;
      if (kind == ViewError::sampson) {
        double const both = second + first;
        if (both != 0) to_r = 2 * g * l.r / both, to_second = to_first = -g * l.r * l.r / (both * both);
      } else {
        auto const add = [&](double square, double& to_square) {
          if (square == 0) return;
          if (kind == ViewError::symmetrical) {
            to_r += 2 * g * l.r / square;
            to_square -= g * l.r * l.r / (square * square);
          } else {
            double const size = sqrt(square);
            to_r += g * (l.r > 0 ? 1 : l.r < 0 ? -1 : 0) / size;
            to_square -= g * magnitude(l.r) / (2 * square * size);
          }
        };
        if (kind != ViewError::left) add(second, to_second);
        if (kind != ViewError::right) add(first, to_first);
      }
      epipolar_vjp(m, x, y, to_r, to_second, to_first, to_x, to_y, to_m);
      return;
    }
    if (kind == ViewError::sampson_transfer) {
      SampsonTransfer const found(m, x, y);
      if (found.volume() > 0) found.vjp(m, x, y, g, to_x, to_y, to_m);
      return;
    }
    if (Mapped<double, double>(m, x[0], x[1]).w != 0) transfer_error_vjp(m, x, y, g, to_x, to_y, to_m);
    if (kind == ViewError::symmetric_transfer && Mapped<double, double>(back, y[0], y[1]).w != 0)
      transfer_error_vjp(back, y, x, g, to_y, to_x, to_back);
  }
};

}  // namespace small

template <class T>
KV_HD void view_error_of(ViewErrors<T> const& p, small::Relation const& relation, int64_t b, int64_t i) {
  double x[4], y[4];
  bool const there = relation.read(p.points1, p.axes1, b * p.problem1 + i * p.axes1, x);
  bool const too = relation.read(p.points2, p.axes2, b * p.problem2 + i * p.axes2, y);
  p.errors.set(b * p.count + i, there && too ? relation.error(x, y) : small::infinity());
}

// The gradients of a part of a problem's correspondences.
template <class T, class Team>
KV_HD void view_errors_backward_of(ViewErrors<T> const& p, int64_t item, Team team) {
  int64_t const parts = p.part_count(), b = item / parts, begin = (item - b * parts) * p.part;
  int64_t const end = min(begin + p.part, p.count);
  small::Relation const relation(p, b);
  double to_m[9] = {}, to_back[9] = {};
  for (int64_t i = begin + team.first(); i < end; i += team.step()) {
    double x[4], y[4], to_x[4] = {}, to_y[4] = {};
    bool const there = relation.read(p.points1, p.axes1, b * p.problem1 + i * p.axes1, x);
    bool const too = relation.read(p.points2, p.axes2, b * p.problem2 + i * p.axes2, y);
    if (there && too) relation.vjp(x, y, p.grad[b * p.count + i], to_x, to_y, to_m, to_back);
    if (!there) x[2] = 1;
    if (!too) y[2] = 1;
    relation.write(p.to1, p.axes1, (b * p.count + i) * p.axes1, x, to_x);
    relation.write(p.to2, p.axes2, (b * p.count + i) * p.axes2, y, to_y);
  }
  for (double& sum : to_m) sum = team.sum(sum) / relation.scale;
  if (relation.kind == ViewError::symmetric_transfer) {
    double rows[9], more[3];
    for (double& sum : to_back) sum = team.sum(sum);
    for (int i = 0; i < 9; ++i) rows[i] = to_back[3 * (i % 3) + i / 3];
    for (int r = 0; r < 3; ++r) {  // row r of the cofactors is the product of the two rows after it
      double const *const g = rows + 3 * r, *const one = relation.m + 3 * ((r + 1) % 3),
                          *const two = relation.m + 3 * ((r + 2) % 3);
      small::cross(two, g, more);
      for (int k = 0; k < 3; ++k) to_m[3 * ((r + 1) % 3) + k] += more[k];
      small::cross(g, one, more);
      for (int k = 0; k < 3; ++k) to_m[3 * ((r + 2) % 3) + k] += more[k];
    }
  }
  if (team.first() == 0)
    for (int i = 0; i < 9; ++i) p.parts.set(9 * item + i, to_m[i]);
}

template <class T>
KV_HD void view_errors_sum(ViewErrors<T> const& p, int64_t b, int k) {
  double sum = 0;
  for (int64_t part = 0; part < p.part_count(); ++part) sum += p.parts[9 * (b * p.part_count() + part) + k];
  p.to_matrix.set(9 * b + k, sum);
}

}  // namespace kv
