// The unit vector v that minimizes the sum of weights * (rows v)^2, and its gradient. v is the eigenvector of the
// smallest eigenvalue of M = sum w r r^T. Second derivatives need all eigenvectors.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

template <class T>
struct NullVector {
  Reals rows, weights;  // (B, m, n), (B, m) or null
  int64_t batch, m;
  int n;
  Reals vector;  // (B, n)
  // For the gradient only:
  Reals grad, grad_rows, grad_weights;  // (B, n), (B, m, n), (B, m)
};

// Eigenvalues (B, n), ascending, of symmetric matrices (B, n, n), and eigenvectors (B, n, n), which are columns.
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

// Sets m, in shared storage, to sum w r r^T.
template <int N, class T, class Group>
KV_HD void normal_matrix(NullVector<T> const& p, int64_t b, Group group, double* m) {
  double sums[N * (N + 1) / 2] = {};
  for (int64_t r = group.thread_rank(); r < p.m; r += group.num_threads()) {
    double const w = p.weights.data ? p.weights[b * p.m + r] : 1;
    double row[N];
    for (int i = 0; i < N; ++i) row[i] = p.rows[(b * p.m + r) * N + i];
    for (int i = 0, index = 0; i < N; ++i)
      for (int k = 0; k <= i; ++k, ++index) sums[index] += w * row[i] * row[k];
  }
  double const* const all = group.sums(sums);
  for (int i = group.thread_rank(); i < N; i += group.num_threads())
    for (int k = 0; k <= i; ++k) m[i * N + k] = m[k * N + i] = all[i * (i + 1) / 2 + k];
  group.sync();
}

template <int N, class T, class Group>
KV_HD void solve_null_vector(NullVector<T> const& p, int64_t b, Group group) {
  typename Group::template SharedStorage<small::EigenSpace<N>> storage;
  small::EigenSpace<N>& space = storage.get();
  normal_matrix<N>(p, b, group, space.matrix);
  auto const warp = group.first_warp();
  if (warp.is_idle()) return;
  small::smallest_eigenvector<N>(space, warp);
  for (int i = warp.thread_rank(); i < N; i += warp.num_threads()) p.vector.set(b * N + i, space.v[i]);
}

template <int N, class T, class Group>
KV_HD void null_vector_vjp(NullVector<T> const& p, int64_t b, Group group) {
  typename Group::template SharedStorage<small::EigenSpace<N>> storage;
  small::EigenSpace<N>& space = storage.get();
  normal_matrix<N>(p, b, group, space.matrix);
  for (int i = group.thread_rank(); i < N; i += group.num_threads())
    space.v[i] = p.vector[b * N + i], space.g[i] = p.grad[b * N + i];
  group.sync();
  auto const warp = group.first_warp();
  if (!warp.is_idle()) small::smallest_eigenvector_vjp<N>(space, warp);
  group.sync();
  double const *const v = space.v, *const u = space.u;
  for (int64_t r = group.thread_rank(); r < p.m; r += group.num_threads()) {
    int64_t const index = b * p.m + r;
    double const w = p.weights.data ? p.weights[index] : 1;
    double by_v = 0, by_u = 0;
    for (int i = 0; i < N; ++i) by_v += p.rows[index * N + i] * v[i], by_u += p.rows[index * N + i] * u[i];
    for (int i = 0; i < N; ++i) p.grad_rows.set(index * N + i, -w * (by_v * u[i] + by_u * v[i]));
    p.grad_weights.set(index, -by_u * by_v);
  }
}

template <int N, class T>
KV_HD void solve_eigenvectors(Eigenvectors<T> const& p, int64_t b) {
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

// Calls f with the number of unknowns as a compile-time constant.
template <int N>
struct Unknowns {
  static constexpr int value = N;
};
template <class F>
KV_HD void dispatch_unknowns(int n, F f) {
  n == 3 ? f(Unknowns<3>{}) : n == 4 ? f(Unknowns<4>{}) : n == 9 ? f(Unknowns<9>{}) : f(Unknowns<12>{});
}

}  // namespace kv::geometry
