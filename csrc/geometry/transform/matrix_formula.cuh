// Matrices that CUDA kernels compute by a formula.
#pragma once

#include "core/launch.cuh"
#include "geometry/formulas.h"

namespace kv::geometry::cuda {

// Inputs are of the compute type. The matrix is rounded to it, as if another kernel had stored it.
template <class F>
struct MatrixRow {
  using Value = double;
  int64_t b;
  template <int N>
  __device__ __forceinline__ void read(TypedPointer const& n, int64_t stride, double* x) const {
#pragma unroll
    for (int i = 0; i < N; ++i) x[i] = static_cast<F const*>(n.data)[b * stride + i];
  }
};

template <class Formula, class F>
__device__ __forceinline__ void make_matrix(MatrixFormula const& p, int64_t b, F* m) {
  double x[Formula::kInputSize], y[Formula::kOutputSize];
  read_inputs<Formula>(p, MatrixRow<F>{b}, x);
  Formula::evaluate(x, y, p.options);
#pragma unroll
  for (int i = 0; i < Formula::kOutputSize; ++i) m[i] = F(y[i]);
}

// Not inlined: one thread of a block calls it once, and inlining would raise the register count of all threads.
#define KV_CASE(name, Formula, inputs) \
  case WarpFormula::name:              \
    return make_matrix<Formula>(p, b, m);

template <class F>
__device__ __noinline__ void make_plane_matrix(MatrixFormula const& p, int64_t b, F* m) {
  switch (p.id) {
    KV_PLANE_FORMULAS(KV_CASE)
    default:
      return;
  }
}

template <class F>
__device__ __noinline__ void make_space_matrix(MatrixFormula const& p, int64_t b, F* m) {
  switch (p.id) {
    KV_SPACE_FORMULAS(KV_CASE)
    default:
      return;
  }
}

#undef KV_CASE

}  // namespace kv::geometry::cuda
