// Homographies from points in one pass of few numbers: normalisation, least squares, back to pixels; and their
// gradient.
//
//   n = s (p - m)            each image's weighted mean m goes to 0, its mean distance d to sqrt(2): s = sqrt(2) / (d +
//   eps) M = sum w r r^T          of the rows r = (0, -n1, y n1), (n1, 0, -x n1) for n1 = (u, v, 1), (x, y) = n2 H =
//   T2^-1 h T1           h the smallest eigenvector of M; divided by its last number unless that is 0
//
// Included by homography_dlt_cpu.cpp, homography_dlt.cu and homography_dlt_op.cpp.
#pragma once

#include "core/isa.h"
#include "small_matrix.h"
#include "team.h"

namespace kv {

template <class T>
struct HomographyDlt {
  Reals points1, points2, weights;  // (B, N, 2), (B, N, 2), (B, N) or null
  int64_t batch, count, stride;     // from the points of a problem to the next one's: 0 where all have the same
  Reals homography;                 // (B, 3, 3)
  // For the gradient only:
  Reals grad, grad1, grad2, grad_weights;
};

KV_KERNEL(homography_dlt, HomographyDlt)
KV_KERNEL(homography_dlt_backward, HomographyDlt)

namespace dlt {

constexpr double kRootTwo = 1.4142135623730951, kEps = 1e-8;

// The weights of one problem as they stand in M, and as shares of the means: none below 0, alike where all are 0.
template <class T>
struct Weights {
  Reals weights;
  int64_t first;
  double total, inverse, alike;
  template <class Team>
  KV_HD Weights(HomographyDlt<T> const& p, int64_t b, Team team)
      : weights(p.weights), first(b * p.count), total(0), inverse(0), alike(1 / double(p.count)) {
    if (!weights.data) return;
    for (int64_t i = team.first(); i < p.count; i += team.step()) total += positive(i);
    total = team.sum(total);
    inverse = 1 / total;
  }
  KV_HD double operator[](int64_t i) const { return weights.data ? weights[first + i] : 1; }
  KV_HD double positive(int64_t i) const { return weights[first + i] < 0 ? 0 : weights[first + i]; }
  KV_HD bool shared() const { return weights.data && total != 0; }
  KV_HD double share(int64_t i) const { return shared() ? positive(i) * inverse : alike; }
};

// Of one image.
struct Frame {
  double mean[2], distance, scale;
  template <class T, class Team>
  KV_HD void set(Reals const& points, int64_t start, Weights<T> const& w, int64_t count, Team team) {
    mean[0] = mean[1] = distance = 0;
    double sum[2] = {};
    for (int64_t i = team.first(); i < count; i += team.step())
      for (int k = 0; k < 2; ++k) sum[k] += w.share(i) * points[2 * (start + i) + k];
    for (int k = 0; k < 2; ++k) mean[k] = team.sum(sum[k]);
    double total = 0;
    for (int64_t i = team.first(); i < count; i += team.step()) {
      double at[2];
      total += w.share(i) * from_mean(points, start + i, at);
    }
    distance = team.sum(total);
    scale = kRootTwo / (distance + kEps);
  }
  KV_HD double from_mean(Reals const& points, int64_t i, double* at) const {
    for (int k = 0; k < 2; ++k) at[k] = points[2 * i + k] - mean[k];
    return sqrt(at[0] * at[0] + at[1] * at[1]);
  }
};

template <class T>
struct Problem {
  HomographyDlt<T> const& p;
  int64_t start;
  Weights<T> weights;
  Frame one, two;

  template <class Team>
  KV_HD Problem(HomographyDlt<T> const& p, int64_t b, Team team) : p(p), start(b * p.stride), weights(p, b, team) {
    one.set(p.points1, start, weights, p.count, team);
    two.set(p.points2, start, weights, p.count, team);
  }

  // (u, v, 1) and (x, y) of a correspondence.
  KV_HD void normalized(int64_t i, double* n1, double* n2) const {
    one.from_mean(p.points1, start + i, n1);
    two.from_mean(p.points2, start + i, n2);
    for (int k = 0; k < 2; ++k) n1[k] *= one.scale, n2[k] *= two.scale;
    n1[2] = 1;
  }

  // M has five different blocks, of which two are 0: sums of w, -w x, -w y, w (x^2 + y^2) times n1 n1^T.
  template <class Team>
  KV_HD void matrix(Team team, double* m) const {
    double sums[4][6] = {};
    for (int64_t i = team.first(); i < p.count; i += team.step()) {
      double n1[3], n2[2];
      normalized(i, n1, n2);
      double const w = weights[i], factors[] = {w, -w * n2[0], -w * n2[1], w * (n2[0] * n2[0] + n2[1] * n2[1])};
      for (int r = 0, at = 0; r < 3; ++r)
        for (int c = 0; c <= r; ++c, ++at)
          for (int f = 0; f < 4; ++f) sums[f][at] += factors[f] * n1[r] * n1[c];
    }
    for (int f = 0; f < 4; ++f)
      for (int at = 0; at < 6; ++at) sums[f][at] = team.sum(sums[f][at]);
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) {
        int const at = i > k ? i * (i + 1) / 2 + k : k * (k + 1) / 2 + i;
        m[9 * i + k] = m[9 * (3 + i) + 3 + k] = sums[0][at];
        m[9 * i + 3 + k] = m[9 * (3 + i) + k] = 0;
        m[9 * i + 6 + k] = m[9 * (6 + i) + k] = sums[1][at];
        m[9 * (3 + i) + 6 + k] = m[9 * (6 + i) + 3 + k] = sums[2][at];
        m[9 * (6 + i) + 6 + k] = sums[3][at];
      }
  }

  // h T1, then T2^-1 times that, up to a factor.
  KV_HD void to_pixels(double const* h, double* before, double* after) const {
    for (int r = 0; r < 9; r += 3) {
      before[r] = one.scale * h[r], before[r + 1] = one.scale * h[r + 1];
      before[r + 2] = h[r + 2] - before[r] * one.mean[0] - before[r + 1] * one.mean[1];
    }
    for (int k = 0; k < 3; ++k) {
      after[k] = before[k] + two.scale * two.mean[0] * before[6 + k];
      after[3 + k] = before[3 + k] + two.scale * two.mean[1] * before[6 + k];
      after[6 + k] = two.scale * before[6 + k];
    }
  }
};

// Of -u^T (sum w r r^T) h to a correspondence: gives it to w, and to the normalised points in g1 and g2.
template <class T>
KV_HD double normalized_vjp(Problem<T> const& problem, double const* u, double const* h, int64_t i, double* g1,
                            double* g2) {
  double n1[3], n2[2];
  problem.normalized(i, n1, n2);
  double const w = problem.weights[i], x = n2[0], y = n2[1], square = x * x + y * y;
  double a[3], c[3];
  for (int k = 0; k < 3; ++k) a[k] = small::dot3(u + 3 * k, n1), c[k] = small::dot3(h + 3 * k, n1);
  double const cross_x = a[0] * c[2] + a[2] * c[0], cross_y = a[1] * c[2] + a[2] * c[1];
  g2[0] = -w * (2 * x * a[2] * c[2] - cross_x);
  g2[1] = -w * (2 * y * a[2] * c[2] - cross_y);
  double const to_a[] = {c[0] - x * c[2], c[1] - y * c[2], square * c[2] - x * c[0] - y * c[1]};
  double const to_c[] = {a[0] - x * a[2], a[1] - y * a[2], square * a[2] - x * a[0] - y * a[1]};
  for (int k = 0; k < 2; ++k) {
    g1[k] = 0;
    for (int r = 0; r < 3; ++r) g1[k] -= w * (to_a[r] * u[3 * r + k] + to_c[r] * h[3 * r + k]);
  }
  return -(a[0] * c[0] + a[1] * c[1] + square * a[2] * c[2] - x * cross_x - y * cross_y);
}

// The gradient to a correspondence's share, from those to the distances and to the means.
template <class T>
KV_HD double share_vjp(Problem<T> const& problem, double const* to_distance, double const (*to_mean)[2], int64_t i) {
  double sum = 0, at[2];
  for (int image = 0; image < 2; ++image) {
    Reals const& points = image ? problem.p.points2 : problem.p.points1;
    int64_t const place = problem.start + i;
    sum += to_distance[image] * (image ? problem.two : problem.one).from_mean(points, place, at);
    for (int k = 0; k < 2; ++k) sum += to_mean[image][k] * points[2 * place + k];
  }
  return sum;
}

// What a homography is divided by: its last number, or its largest one where that is 0.
KV_HD double divisor(double const* h, bool& last) {
  double largest = 0;
  for (int i = 0; i < 9; ++i) largest = max(largest, small::magnitude(h[i]));
  last = small::magnitude(h[8]) > 1e-12 * largest;
  return last ? h[8] : largest > 0 ? largest : 1;
}

}  // namespace dlt

template <class T, class Team>
KV_HD void homography_dlt_of(HomographyDlt<T> const& p, int64_t b, Team team) {
  dlt::Problem<T> const problem(p, b, team);
  double m[81], h[9], before[9], after[9];
  problem.matrix(team, m);
  if (team.first() != 0) return;  // one thread's matrices fit into the nearest cache, where those of all would not
  small::smallest_eigenvector<9>(m, h);
  problem.to_pixels(h, before, after);
  bool last;
  double const scale = 1 / dlt::divisor(after, last);
  for (int i = 0; i < 9; ++i) p.homography.set(9 * b + i, after[i] * scale);
}

template <class T, class Team>
KV_HD void homography_dlt_backward_of(HomographyDlt<T> const& p, int64_t b, Team team) {
  dlt::Problem<T> const problem(p, b, team);
  dlt::Frame const &one = problem.one, &two = problem.two;
  double m[81], h[9], before[9], after[9], g[9], to_h[9], u[9];
  problem.matrix(team, m);

  double copy[81];
  for (int i = 0; i < 81; ++i) copy[i] = m[i];
  small::smallest_eigenvector<9>(copy, h);
  problem.to_pixels(h, before, after);

  // To `after`, then through to_pixels: to h, and to the frames as sums[image] = (to s, to m).
  bool last;
  double const scale = 1 / dlt::divisor(after, last);
  double along = 0, to_scale[2] = {}, to_mean[2][2] = {};
  for (int i = 0; i < 9; ++i) g[i] = p.grad[9 * b + i] * scale, along += g[i] * after[i] * scale;
  if (last) g[8] -= along;
  for (int k = 0; k < 3; ++k) {
    to_mean[1][0] += two.scale * g[k] * before[6 + k];
    to_mean[1][1] += two.scale * g[3 + k] * before[6 + k];
    double const by_scale = two.mean[0] * g[k] + two.mean[1] * g[3 + k] + g[6 + k];
    to_scale[1] += by_scale * before[6 + k];
    g[6 + k] = two.scale * by_scale;
  }
  for (int r = 0; r < 9; r += 3) {
    for (int k = 0; k < 2; ++k) {
      double const inner = g[r + k] - g[r + 2] * one.mean[k];
      to_scale[0] += inner * h[r + k];
      to_mean[0][k] -= g[r + 2] * one.scale * h[r + k];
      to_h[r + k] = one.scale * inner;
    }
    to_h[r + 2] = g[r + 2];
  }
  small::smallest_eigenvector_vjp<9>(m, h, to_h, u);

  // First to the frames: n = s (p - m), s = sqrt(2) / (d + eps), d = sum share |p - m|.
  double direct[2][3] = {}, apart[2][2] = {};  // to m and s by n, and the mean of (p - m) / |p - m|
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    double gn[2][2];
    dlt::normalized_vjp(problem, u, h, i, gn[0], gn[1]);
    for (int image = 0; image < 2; ++image) {
      dlt::Frame const& f = image ? two : one;
      double at[2], share = problem.weights.share(i);
      double const length = f.from_mean(image ? p.points2 : p.points1, problem.start + i, at);
      for (int k = 0; k < 2; ++k) {
        direct[image][k] -= f.scale * gn[image][k];
        direct[image][2] += gn[image][k] * at[k];
        if (length > 0) apart[image][k] += share * at[k] / length;
      }
    }
  }
  double to_distance[2];
  for (int image = 0; image < 2; ++image) {
    dlt::Frame const& f = image ? two : one;
    to_scale[image] += team.sum(direct[image][2]);
    to_distance[image] = -to_scale[image] * f.scale * f.scale / dlt::kRootTwo;
    for (int k = 0; k < 2; ++k)
      to_mean[image][k] += team.sum(direct[image][k]) - to_distance[image] * team.sum(apart[image][k]);
  }

  // Then to points and to shares, whose sum is 1.
  double common = 0;
  if (problem.weights.shared()) {
    for (int64_t i = team.first(); i < p.count; i += team.step())
      common += problem.weights.share(i) * dlt::share_vjp(problem, to_distance, to_mean, i);
    common = team.sum(common);
  }
  for (int64_t i = team.first(); i < p.count; i += team.step()) {
    int64_t const place = problem.start + i;
    double gn[2][2];
    double to_weight = dlt::normalized_vjp(problem, u, h, i, gn[0], gn[1]);
    for (int image = 0; image < 2; ++image) {
      dlt::Frame const& f = image ? two : one;
      double at[2], share = problem.weights.share(i);
      double const length = f.from_mean(image ? p.points2 : p.points1, place, at);
      for (int k = 0; k < 2; ++k) {
        double const outward = length > 0 ? to_distance[image] * at[k] / length : 0;
        (image ? p.grad2 : p.grad1).set(2 * place + k, f.scale * gn[image][k] + share * (outward + to_mean[image][k]));
      }
    }
    if (problem.weights.shared() && problem.weights[i] >= 0)
      to_weight += (dlt::share_vjp(problem, to_distance, to_mean, i) - common) / problem.weights.total;
    p.grad_weights.set(place, to_weight);
  }
}

}  // namespace kv
