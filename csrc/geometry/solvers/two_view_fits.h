// Fits by sigma-consensus++ that start from many models of many pairs of images. A round reads each correspondence once
// and sums what the score of the model and the next fit need:
//
//   e     squared error: Sampson's distance of epipolar geometry, the distance of the mapped point of other models
//   w     exp(-x) - exp(-x_end) for x = x_end e / reach^2 below x_end, else 0: the weight of the correspondence
//   gain  w + exp(-x_end) (x - x_end), whose sum is the score
//   M     sum of w / v r r^T for the linear equations r m = 0 of the model m, whose variances are v
//   L     what the change of the variances with the model contributes: the gradient of the error is 2 (M - L) m
//
// An affine map solves the least squares of its equations, a homography is M's least eigenvector. A fundamental matrix
// is the least eigenvector of M - L, moved to the nearest matrix of rank 2 in the metric of M - L, an essential matrix
// takes Newton's steps on its manifold. Points are normalized but for essential matrices.
//
// Fits that adapt, of fundamental matrices, estimate the noise together with the model, by expectation maximization:
// the residuals of right correspondences are normal numbers of variance s, those of wrong ones equally frequent
// everywhere. With A, how much more frequent right ones are where e is 0, the weight is the probability to be right:
//
//   w     g / (1 + g) for g = A exp(-e / (2 s)), within 2 reach
//
// A point that is not finite has weight 0. Fits from a model end when its score does not rise.
#pragma once

#include "core/any_lane.h"
#include "core/isa.h"
#include "geometry/residuals.h"
#include "geometry/small_matrix.h"
#include "geometry/solvers/minimal.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

template <class T>
struct TwoViewFits {
  T const *models, *points1, *points2, *weights, *reaches;  // (B, K, 9), (B, 2, N), (B, 2, N), (B, N) or null, (B)
  Model model;
  int64_t rounds, batch, num_models, count;  // ., B, K, N
  bool adapts;
  T *fitted, *scores;  // (B, K, 9), (B, K)
};

KV_KERNEL(two_view_fits, TwoViewFits)

namespace two_view {

constexpr double kEnd = 11.345 / 2;  // x_end: 99% of the squared norms of three normal numbers are below its double
constexpr double kRest = 0.003439256378518648;  // exp(-x_end)
constexpr double kTolerance = 1e-5;             // the relative increase of a score that a further fit is worth
constexpr int kSteps = 3;                       // of Newton's method; each doubles the correct digits
constexpr int kNoiseRounds = 2;                 // the first ones of fits that adapt estimate the noise alone
constexpr double kFreedom = 7;                  // of a fundamental matrix
constexpr double kTiny = 2.2250738585072014e-308;

// The products of (x, y, 1) with itself, in the order of `product_index`.
template <class V>
KV_HD void add_products(V s, V x, V y, V* sums) {
  V const sx = s * x, sy = s * y;
  sums[0] += sx * x, sums[1] += sx * y, sums[2] += sx;
  sums[3] += sy * y, sums[4] += sy, sums[5] += s;
}
KV_HD int product_index(int i, int k) { return i + k + (i > 0 && k > 0); }

// n = scale (p - mean): the points have mean 0 and mean distance sqrt(2) from it.
struct Similarity {
  double scale = 1, x = 0, y = 0;

  KV_HD void matrix(double* T) const {
    double const all[] = {scale, 0, -scale * x, 0, scale, -scale * y, 0, 0, 1};
    for (int i = 0; i < 9; ++i) T[i] = all[i];
  }
  KV_HD void inverse(double* T) const {
    double const all[] = {1 / scale, 0, x, 0, 1 / scale, y, 0, 0, 1};
    for (int i = 0; i < 9; ++i) T[i] = all[i];
  }
};

// A correspondence in normalized coordinates, or several in lanes.
template <class V>
struct Correspondence {
  V x, y, u, v;
};

// The kinds of models. `error` sets e and v; `add` adds w / v and w / v e of a correspondence to `sums`.

struct Affine {
  static constexpr int kSums = 12;
  static constexpr bool kIsNormalized = true, kIsEpipolar = false, kAdapts = false;

  template <class V>
  static KV_HD void error(double const* m, Similarity const&, Similarity const& two, Correspondence<V> const& c, V& e,
                          V& variance) {
    e = transfer_error(m, c.x, c.y, c.u, c.v) * (1 / (two.scale * two.scale));
    variance = V{} + 1;
  }
  template <class V>
  static KV_HD void add(Similarity const&, Similarity const&, Correspondence<V> const& c, V s, V, V* sums) {
    add_products(s, c.x, c.y, sums);
    V const su = s * c.u, sv = s * c.v;
    sums[6] += su * c.x, sums[7] += su * c.y, sums[8] += su;
    sums[9] += sv * c.x, sums[10] += sv * c.y, sums[11] += sv;
  }
};

struct Homography {
  static constexpr int kSums = 24;
  static constexpr bool kIsNormalized = true, kIsEpipolar = false, kAdapts = false;

  template <class V>
  static KV_HD void error(double const* m, Similarity const& one, Similarity const& two, Correspondence<V> const& c,
                          V& e, V& variance) {
    double const ratio = two.scale / one.scale;
    Mapped<V, double> const h(m, c.x, c.y);
    V const p = h.u - h.w * c.u, q = h.v - h.w * c.v, square = h.w * h.w;
    e = (p * p + q * q) / (square * (two.scale * two.scale));
    V const a = m[0] - c.u * m[6], b = m[1] - c.u * m[7], d = m[3] - c.v * m[6], f = m[4] - c.v * m[7];
    variance = a * a + b * b + d * d + f * f + square * (2 * ratio * ratio);
  }
  template <class V>
  static KV_HD void add(Similarity const&, Similarity const&, Correspondence<V> const& c, V s, V, V* sums) {
    add_products(s, c.x, c.y, sums);
    add_products(V(s * c.u), c.x, c.y, sums + 6);
    add_products(V(s * c.v), c.x, c.y, sums + 12);
    add_products(V(s * (c.u * c.u + c.v * c.v)), c.x, c.y, sums + 18);
  }
  // The rows are (p, 0, -u p) and (0, p, -v p), p = (x, y, 1).
  template <class Group>
  static KV_HD void normal_matrix(double const* sums, double* M, Group group) {
    for (int entry = group.thread_rank(); entry < 81; entry += group.num_threads()) {
      int const row = entry / 9, column = entry % 9, i = row / 3, k = column / 3;
      double const* const products = sums + product_index(row % 3, column % 3);
      M[entry] = (i == 2 && k == 2) ? products[18]
                 : i == 2           ? -products[6 + 6 * k]
                 : k == 2           ? -products[6 + 6 * i]
                 : i == k           ? products[0]
                                    : 0;
    }
    group.sync();
  }
};

struct EpipolarForm {
  static constexpr int kSums = 48;
  static constexpr bool kIsEpipolar = true;

  template <class V>
  static KV_HD void error(double const* m, Similarity const& one, Similarity const& two, Correspondence<V> const& c,
                          V& e, V& variance) {
    V const unit = V{} + 1;
    Epipolar<V, double> const l(m, c.x, c.y, unit, c.u, c.v, unit);
    variance = l.second() * (two.scale * two.scale) + l.first() * (one.scale * one.scale);
    e = l.r * l.r / variance;
  }
  template <class V>
  static KV_HD void add(Similarity const&, Similarity const&, Correspondence<V> const& c, V s, V change, V* sums) {
    V const su = s * c.u, sv = s * c.v;
    add_products(V(su * c.u), c.x, c.y, sums);
    add_products(V(su * c.v), c.x, c.y, sums + 6);
    add_products(su, c.x, c.y, sums + 12);
    add_products(V(sv * c.v), c.x, c.y, sums + 18);
    add_products(sv, c.x, c.y, sums + 24);
    add_products(s, c.x, c.y, sums + 30);
    add_products(change, c.x, c.y, sums + 36);
    add_products(change, c.u, c.v, sums + 42);
  }
  // M, and M - L.
  template <class Group>
  static KV_HD void normal_matrices(double const* sums, Similarity const& one, Similarity const& two, double* M,
                                    double* difference, Group group) {
    double const total = 1 / max(sums[35], kTiny), of_x = two.scale * two.scale, of_y = one.scale * one.scale;
    for (int entry = group.thread_rank(); entry < 81; entry += group.num_threads()) {
      int const row = entry / 9, column = entry % 9, i = row / 3, j = row % 3, k = column / 3, l = column % 3;
      double const m = sums[6 * product_index(i, k) + product_index(j, l)];
      double const change = (i == k && i < 2 ? of_x * sums[36 + product_index(j, l)] : 0) +
                            (j == l && j < 2 ? of_y * sums[42 + product_index(i, k)] : 0);
      M[entry] = m * total;
      difference[entry] = (m - change) * total;
    }
    group.sync();
  }
};
struct Fundamental : EpipolarForm {
  static constexpr bool kIsNormalized = true, kAdapts = true;
};
struct Essential : EpipolarForm {
  static constexpr bool kIsNormalized = false, kAdapts = false;
};

// What the threads of a problem share.
struct Workspace {
  double model[9], best[9];
  double M[81], difference[81];
  small::EigenSpace<9> space;
};

// --- fits ------------------------------------------------------------------------------------------------------------

// Threads of one warp call them; the first thread writes the model.

template <class Group>
KV_CALLED void fit(Affine, double const* sums, Similarity const&, Similarity const&, Workspace& work, Group group) {
  if (group.thread_rank() == 0) {
    double A[9], inverse[9];
    for (int i = 0; i < 9; ++i) A[i] = sums[product_index(i / 3, i % 3)];
    adjugate3(A, inverse);
    double const scale = 1 / dot3(A, inverse);
    for (int r = 0; r < 2; ++r)
      for (int k = 0; k < 3; ++k) work.model[3 * r + k] = scale * dot3(inverse + 3 * k, sums + 6 + 3 * r);
    work.model[6] = work.model[7] = 0, work.model[8] = 1;
  }
  group.sync();
}

template <class Group>
KV_CALLED void fit(Homography, double const* sums, Similarity const&, Similarity const&, Workspace& work, Group group) {
  Homography::normal_matrix(sums, work.space.matrix, group);
  small::smallest_eigenvector<9>(work.space, group);
  for (int i = group.thread_rank(); i < 9; i += group.num_threads()) work.model[i] = work.space.v[i];
  group.sync();
}

// L is at most its trace, so M - L plus this trace is positive semidefinite, with the same eigenvectors.
template <class Group>
KV_CALLED void fit(Fundamental, double const* sums, Similarity const& one, Similarity const& two, Workspace& work,
                   Group group) {
  EpipolarForm::normal_matrices(sums, one, two, work.M, work.difference, group);
  small::EigenSpace<9>& space = work.space;
  double trace = 0, shift = 0;
  for (int i = 0; i < 81; i += 10) trace += work.M[i], shift += work.M[i] - work.difference[i];
  for (int i = group.thread_rank(); i < 81; i += group.num_threads())
    space.matrix[i] = work.difference[i] + (i % 10 == 0 ? shift : 0);
  group.sync();
  small::smallest_eigenvector<9>(space, group);
  // The pseudoinverse of M - L minus its least eigenvalue.
  small::multiply_vector<9>(work.difference, space.v, space.r, group);
  double const least = small::dot<9>(space.r, space.v);
  for (int i = group.thread_rank(); i < 81; i += group.num_threads())
    space.inverse[i] = work.difference[i] - (i % 10 == 0 ? least - 1e-15 : 0) + trace * space.v[i / 9] * space.v[i % 9];
  group.sync();
  small::invert<9>(space.inverse, group);
  for (int i = group.thread_rank(); i < 81; i += group.num_threads())
    space.inverse[i] -= space.v[i / 9] * space.v[i % 9] / (trace + 1e-15);
  group.sync();
  double *const f = space.g, *const n = space.u, *const step = space.r;
  for (int i = group.thread_rank(); i < 9; i += group.num_threads()) f[i] = space.v[i];
  group.sync();
  for (int s = 0; s < kSteps; ++s) {
    if (group.thread_rank() == 0) cofactors3(f, n);
    group.sync();
    small::multiply_vector<9>(space.inverse, n, step, group);
    double const factor = dot3(f, n) / max(small::dot<9>(n, step), kTiny);
    group.sync();
    for (int i = group.thread_rank(); i < 9; i += group.num_threads()) f[i] -= step[i] * factor;
    group.sync();
  }
  for (int i = group.thread_rank(); i < 9; i += group.num_threads()) work.model[i] = f[i];
  group.sync();
}

// E becomes R(a) E R(b), for Cayley's rotations R(a) = 1 + (A + A A / 2) 4 / (4 + a a), A = [a]x.
KV_HD void rotate(double const* a, double* E, bool from_left) {
  double const A[] = {0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0}, scale = 4 / (4 + dot3(a, a));
  double R[9], product[9];
  multiply3(A, A, R);
  for (int i = 0; i < 9; ++i) R[i] = (i % 4 == 0) + scale * (A[i] + R[i] / 2);
  from_left ? multiply3(R, E, product) : multiply3(E, R, product);
  for (int i = 0; i < 9; ++i) E[i] = product[i];
}

template <class Group>
KV_CALLED void fit(Essential, double const* sums, Similarity const& one, Similarity const& two, Workspace& work,
                   Group group) {
  EpipolarForm::normal_matrices(sums, one, two, work.M, work.difference, group);
  double *const E = work.model, *const tangents = work.space.powers, *const products = work.space.square;
  double *const H = work.space.inverse, *const gradient = work.space.r, *const slope = work.space.g;
  if (group.thread_rank() == 0) {
    double const scale = 1 / sqrt(small::dot<9>(E, E));
    for (int i = 0; i < 9; ++i) E[i] *= scale;
  }
  group.sync();
  for (int s = 0; s < kSteps; ++s) {  // along [a]x E + E [b]x
    for (int t = group.thread_rank(); t < 6; t += group.num_threads()) {
      double axis[9] = {}, product[9];
      int const k = t % 3, i = (k + 1) % 3, j = (k + 2) % 3;
      axis[3 * j + i] = 1, axis[3 * i + j] = -1;
      t < 3 ? multiply3(axis, E, product) : multiply3(E, axis, product);
      for (int e = 0; e < 9; ++e) tangents[9 * t + e] = product[e];
    }
    small::multiply_vector<9>(work.difference, E, gradient, group);
    for (int e = group.thread_rank(); e < 54; e += group.num_threads())
      products[e] = small::dot<9>(tangents + e / 9 * 9, work.M + e % 9 * 9);
    group.sync();
    double damping = 0;
    for (int t = 0; t < 6; ++t) damping += 1e-9 * small::dot<9>(products + 9 * t, tangents + 9 * t);
    for (int e = group.thread_rank(); e < 36; e += group.num_threads())
      H[e] = small::dot<9>(products + e / 6 * 9, tangents + e % 6 * 9) + (e % 7 == 0 ? damping : 0);
    for (int t = group.thread_rank(); t < 6; t += group.num_threads())
      slope[t] = small::dot<9>(tangents + 9 * t, gradient);
    group.sync();
    small::invert<6>(H, group);
    if (group.thread_rank() == 0) {
      double step[6];
      for (int t = 0; t < 6; ++t) step[t] = -small::dot<6>(H + 6 * t, slope);
      rotate(step, E, true);
      rotate(step + 3, E, false);
    }
    group.sync();
  }
}

// --- rounds ----------------------------------------------------------------------------------------------------------

// Calls f with the correspondences of pair b in lanes, as pixels, and their weights. `Vector` says how to load them.
template <class Vector, class T, class Group, class F>
KV_HD void for_each_correspondence(TwoViewFits<T> const& p, int64_t b, Group group, F f) {
  constexpr int N = Vector::kCount;
  using V = typename Vector::V;
  T const *const x = p.points1 + 2 * b * p.count, *const u = p.points2 + 2 * b * p.count;
  T const* const w = p.weights ? p.weights + b * p.count : nullptr;
  V const one = V{} + 1;
  int64_t const whole = p.count / N * N;
  for (int64_t i = group.thread_rank() * N; i < whole; i += group.num_threads() * N)
    f(Correspondence<V>{Vector::load(x + i), Vector::load(x + p.count + i), Vector::load(u + i),
                        Vector::load(u + p.count + i)},
      w ? Vector::load(w + i) : one);
  if (whole == p.count) return;
  T rest[5][N] = {};  // weight 0 behind the last
  for (int64_t i = whole; i < p.count; ++i) {
    int const k = int(i - whole);
    rest[0][k] = x[i], rest[1][k] = x[p.count + i], rest[2][k] = u[i], rest[3][k] = u[p.count + i];
    rest[4][k] = w ? w[i] : 1;
  }
  f(Correspondence<V>{Vector::load(rest[0]), Vector::load(rest[1]), Vector::load(rest[2]), Vector::load(rest[3])},
    Vector::load(rest[4]));
}

// The result is the same for all threads.
template <class Vector, int K, class Group>
KV_HD double const* sums_of(typename Vector::V const (&lanes)[K], double (&sums)[K], Group group) {
#pragma unroll
  for (int k = 0; k < K; ++k) sums[k] = Vector::sum(lanes[k]);
  return group.sums(sums);
}

// Returns the mean weight of the correspondences that exist, and sets how many do.
template <class Vector, class T, class Group>
KV_HD double normalize(TwoViewFits<T> const& p, int64_t b, Group group, Similarity& one, Similarity& two,
                       double& existing) {
  using V = typename Vector::V;
  V const zero{};
  V moments[6] = {}, distances[2] = {};
  for_each_correspondence<Vector>(p, b, group, [&](Correspondence<V> const& c, V w) KV_INLINE {
    V const all = c.x + c.y + c.u + c.v;
    auto const exists = (w > 0) & (all - all == 0);
    moments[0] += exists ? V(zero + 1) : zero;
    moments[1] += exists ? c.x : zero, moments[2] += exists ? c.y : zero;
    moments[3] += exists ? c.u : zero, moments[4] += exists ? c.v : zero;
    moments[5] += exists ? w : zero;
  });
  double partial[6], rest[2];
  double const* const sums = sums_of<Vector>(moments, partial, group);
  double const count = max(sums[0], 1.), weight = sums[5] / count;
  existing = sums[0];
  one.x = sums[1] / count, one.y = sums[2] / count, two.x = sums[3] / count, two.y = sums[4] / count;
  for_each_correspondence<Vector>(p, b, group, [&](Correspondence<V> const& c, V w) KV_INLINE {
    V const x = c.x - one.x, y = c.y - one.y, u = c.u - two.x, v = c.v - two.y, all = x + y + u + v;
    auto const exists = (w > 0) & (all - all == 0);
    distances[0] += exists ? Vector::root(x * x + y * y) : zero;
    distances[1] += exists ? Vector::root(u * u + v * v) : zero;
  });
  double const* const totals = sums_of<Vector>(distances, rest, group);
  one.scale = totals[0] > 0 ? 1.4142135623730951 * count / totals[0] : 1;
  two.scale = totals[1] > 0 ? 1.4142135623730951 * count / totals[1] : 1;
  return weight;
}

// How the squared error tells the weight of a correspondence.
struct Noise {
  double square, per_error;  // of the largest error that counts; x = per_error e
  double odds = 0;           // A of fits that adapt
};

// The noise of fits that adapt, from estimates that the sums of a pass improve.
struct MixedNoise {
  double limit, existing, extent;  // the square of the reach, of all correspondences, of residuals of wrong ones
  double variance = limit / (2 * kEnd), right = existing / 2;

  KV_HD Noise noise() const {
    double const wrong = (existing - right + 1) / extent;
    return {4 * limit, 1 / (2 * variance), right / (wrong * sqrt(6.283185307179586 * variance))};
  }
  KV_HD void update(double count, double squares) {
    right = count;
    variance = min(max(squares / max(count - kFreedom, 1.), 1e-6 * limit), limit / 4);
  }
};

// The sums of the next fit, and behind them the score of the model; of fits that adapt the sums of weights and of
// weighted errors.
template <class Kind, class Vector, class T, class Group>
KV_HD double const* pass(TwoViewFits<T> const& p, int64_t b, double const* model, Similarity const& one,
                         Similarity const& two, Noise const& noise, double (&sums)[Kind::kSums + 2], Group group) {
  using V = typename Vector::V;
  constexpr double kLog2 = 1.4426950408889634;
  double const square = noise.square, per_error = noise.per_error, odds = noise.odds;
  double m[9];
  for (int i = 0; i < 9; ++i) m[i] = model[i];
  V lanes[Kind::kSums + 2] = {};
  V const zero{};
  for_each_correspondence<Vector>(p, b, group, [&](Correspondence<V> c, V w) KV_INLINE {
    if constexpr (Kind::kIsNormalized)
      c = {(c.x - one.x) * one.scale, (c.y - one.y) * one.scale, (c.u - two.x) * two.scale, (c.v - two.y) * two.scale};
    V e, variance;
    Kind::error(m, one, two, c, e, variance);
    auto const counts = (e < square) & (w > 0);
    if (!any_lane(counts)) return;
    V const x = e * per_error, likelihood = Vector::exp2(x * -kLog2);
    w = counts ? w : zero;
    e = counts ? e : zero;
    V s;
    if (Kind::kAdapts && odds > 0) {
      V const ratio = likelihood * odds;
      s = w * (counts ? V(ratio / (ratio + 1)) : zero);
      lanes[Kind::kSums] += s, lanes[Kind::kSums + 1] += s * e;
    } else {
      lanes[Kind::kSums] += w * (counts ? V(likelihood + (x - (kEnd + 1)) * kRest) : zero);
      s = w * (counts ? V(likelihood - kRest) : zero);
    }
    s = s / (counts ? variance : V(zero + 1));
    c = {counts ? c.x : zero, counts ? c.y : zero, counts ? c.u : zero, counts ? c.v : zero};
    Kind::add(one, two, c, s, V(s * e), lanes);
  });
  return sums_of<Vector>(lanes, sums, group);
}

// From pixels to normalized coordinates of both images, or back.
template <class Kind>
KV_HD void change_coordinates(double const* model, Similarity const& one, Similarity const& two, bool back,
                              double* result) {
  double first[9], second[9], product[9];
  back ? one.matrix(first) : one.inverse(first);
  if constexpr (Kind::kIsEpipolar) {
    back ? two.matrix(second) : two.inverse(second);
    multiply3<true>(second, model, product);
  } else {
    back ? two.inverse(second) : two.matrix(second);
    multiply3(second, model, product);
  }
  multiply3(product, first, result);
}

template <class Kind, class Vector, class T, class Group>
KV_HD void fit_from(TwoViewFits<T> const& p, int64_t item, Group group) {
  typename Group::template SharedStorage<Workspace> storage;
  Workspace& work = storage.get();
  int64_t const b = item / p.num_models;
  T const* const start = p.models + 9 * item;
  bool is_known = true;
  for (int i = 0; i < 9; ++i) is_known = is_known && small::finite(start[i]);
  if (!is_known) {  // of no model that a pair has
    for (int i = group.thread_rank(); i < 9; i += group.num_threads()) p.fitted[9 * item + i] = T(small::nan());
    if (group.thread_rank() == 0) p.scores[item] = 0;
    return;
  }
  Similarity one, two;
  double existing = 0, mean_weight = 1;
  if constexpr (Kind::kIsNormalized) mean_weight = normalize<Vector>(p, b, group, one, two, existing);
  if (group.thread_rank() == 0) {
    double model[9];
    for (int i = 0; i < 9; ++i) model[i] = start[i];
    change_coordinates<Kind>(model, one, two, false, work.model);
    for (int i = 0; i < 9; ++i) work.best[i] = work.model[i];
  }
  group.sync();
  double best_score = 0;
  double const limit = p.reaches[b] * p.reaches[b];
  Noise noise{limit, kEnd / limit};
  MixedNoise mixed{limit, existing, 1.4142135623730951 * (1 / one.scale + 1 / two.scale)};
  if (Kind::kAdapts && p.adapts) noise = mixed.noise();
  auto const warp = group.first_warp();
  for (int64_t round = 0;; ++round) {
    double partial[Kind::kSums + 2];
    double const* const sums = pass<Kind, Vector>(p, b, work.model, one, two, noise, partial, group);
    double score = sums[Kind::kSums];
    bool rises = score > best_score * (1 + kTolerance), is_better = round == 0 || score > best_score, is_fitted = true;
    if (Kind::kAdapts && p.adapts) {
      score /= mean_weight;
      rises = is_better = score > kFreedom;
      is_fitted = round >= kNoiseRounds;
      mixed.update(score, sums[Kind::kSums + 1] / mean_weight);
      noise = mixed.noise();
    }
    if (is_better) {
      best_score = score;
      for (int i = group.thread_rank(); i < 9; i += group.num_threads()) work.best[i] = work.model[i];
    }
    group.sync();
    if (!rises || round == p.rounds) break;
    if (is_fitted && !warp.is_idle()) fit(Kind{}, sums, one, two, work, warp);
    group.sync();
  }
  if (group.thread_rank() != 0) return;
  double result[9];
  change_coordinates<Kind>(work.best, one, two, true, result);
  for (int i = 0; i < 9; ++i) p.fitted[9 * item + i] = T(result[i]);
  p.scores[item] = T(best_score);
}

template <class F>
KV_HD void dispatch_kind(Model model, F f) {
  model == Model::affine       ? f(Affine{})
  : model == Model::homography ? f(Homography{})
  : model == Model::essential  ? f(Essential{})
                               : f(Fundamental{});
}

}  // namespace two_view
}  // namespace kv::geometry
