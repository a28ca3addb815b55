// The vector v of length 1 with the least sum of weights * (rows v)^2, and its gradient: from M = sum w r r^T, whose
// smallest eigenvector it is. All eigenvectors are for its further derivatives. Included by null_vector_cpu.cpp,
// null_vector.cu and null_vector_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv {

template <class T>
struct NullVector {
  Reals rows, weights;  // (B, m, n), (B, m) or null
  int64_t batch, m;
  int n;
  Reals vector;  // (B, n)
  // For the gradient only:
  Reals grad, grad_rows, grad_weights;  // (B, n), (B, m, n), (B, m)
};

// Of symmetric matrices (B, n, n), ascending values (B, n) and the columns (B, n, n) that belong to them.
template <class T>
struct Eigenvectors {
  Reals matrix;
  int64_t batch;
  int n;
  Reals values, vectors;
};

KV_KERNEL(null_vector, NullVector)
KV_KERNEL(null_vector_backward, NullVector)
KV_KERNEL(eigenvectors, Eigenvectors)

// To `m`, which all of the team see.
template <int N, class T, class Team>
KV_HD void normal_matrix(NullVector<T> const& p, int64_t b, Team team, double* m) {
  double sums[N * (N + 1) / 2] = {};
  for (int64_t r = team.first(); r < p.m; r += team.step()) {
    double const w = p.weights.data ? p.weights[b * p.m + r] : 1;
    double row[N];
    for (int i = 0; i < N; ++i) row[i] = p.rows[(b * p.m + r) * N + i];
    for (int i = 0, at = 0; i < N; ++i)
      for (int k = 0; k <= i; ++k, ++at) sums[at] += w * row[i] * row[k];
  }
  double const* const all = team.sums(sums);
  for (int i = team.first(); i < N; i += team.step())
    for (int k = 0; k <= i; ++k) m[i * N + k] = m[k * N + i] = all[i * (i + 1) / 2 + k];
  team.sync();
}

template <int N, class T, class Team>
KV_HD void null_vector_of(NullVector<T> const& p, int64_t b, Team team) {
  typename Team::template Kept<small::EigenSpace<N>> kept;
  small::EigenSpace<N>& space = kept.get();
  normal_matrix<N>(p, b, team, space.matrix);
  auto const few = team.few();
  if (few.idle()) return;
  small::smallest_eigenvector<N>(space, few);
  for (int i = few.first(); i < N; i += few.step()) p.vector.set(b * N + i, space.v[i]);
}

template <int N, class T, class Team>
KV_HD void null_vector_backward_of(NullVector<T> const& p, int64_t b, Team team) {
  typename Team::template Kept<small::EigenSpace<N>> kept;
  small::EigenSpace<N>& space = kept.get();
  normal_matrix<N>(p, b, team, space.matrix);
  for (int i = team.first(); i < N; i += team.step()) space.v[i] = p.vector[b * N + i], space.g[i] = p.grad[b * N + i];
  team.sync();
  auto const few = team.few();
  if (!few.idle()) small::smallest_eigenvector_vjp<N>(space, few);
  team.sync();
  double const *const v = space.v, *const u = space.u;
  for (int64_t r = team.first(); r < p.m; r += team.step()) {
    int64_t const at = b * p.m + r;
    double const w = p.weights.data ? p.weights[at] : 1;
    double by_v = 0, by_u = 0;
    for (int i = 0; i < N; ++i) by_v += p.rows[at * N + i] * v[i], by_u += p.rows[at * N + i] * u[i];
    for (int i = 0; i < N; ++i) p.grad_rows.set(at * N + i, -w * (by_v * u[i] + by_u * v[i]));
    p.grad_weights.set(at, -by_u * by_v);
  }
}

template <int N, class T>
KV_HD void eigenvectors_of(Eigenvectors<T> const& p, int64_t b) {
  double m[N * N], v[N * N];
  for (int i = 0; i < N * N; ++i) m[i] = p.matrix[b * N * N + i];
  small::diagonalize<N>(m, v);
  for (int i = 0; i < N; ++i) {
    double const value = m[i * (N + 1)];
    int rank = 0;
    for (int k = 0; k < N; ++k) {
      double const other = m[k * (N + 1)];
      rank += other < value || (other == value && k < i);
    }
    p.values.set(b * N + rank, value);
    for (int k = 0; k < N; ++k) p.vectors.set((b * N + k) * N + rank, v[k * N + i]);
  }
}

// Calls f with the number of unknowns, for the compiler to know.
template <int N>
struct Unknowns {
  static constexpr int value = N;
};
template <class F>
KV_HD void with_unknowns(int n, F f) {
  n == 3 ? f(Unknowns<3>{}) : n == 4 ? f(Unknowns<4>{}) : n == 9 ? f(Unknowns<9>{}) : f(Unknowns<12>{});
}

}  // namespace kv
