// DLT of camera poses; see dlt.h.
#pragma once

#include "geometry/solvers/dlt_homography.h"

namespace kv::geometry::dlt_models {

// Converts a camera (3, 4) of any scale and sign into a pose: the columns of the rotation are made orthogonal one after
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

}  // namespace kv::geometry::dlt_models
