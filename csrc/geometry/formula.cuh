// Formulas on CUDA: one thread for each sample.
// Included by formula_*.cu, which instantiate the formulas by subject.
#pragma once

#include "core/launch.cuh"
#include "geometry/formulas.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 64;

struct Sample {
  using Value = double;
  int64_t b;

  template <class T>
  static __device__ __forceinline__ T const* typed(TypedPointer const& n) {
    return static_cast<T const*>(n.data);
  }
  static __device__ __forceinline__ double number(TypedPointer const& n, int64_t i) {
    if (n.type == DType::float32) return typed<float>(n)[i];
    if (n.type == DType::float64) return typed<double>(n)[i];
    return n.type == DType::float16 ? kv::read(typed<Half>(n)[i]) : kv::read(typed<BFloat16>(n)[i]);
  }
  static __device__ __forceinline__ void set(TypedPointer const& n, int64_t i, double x) {
    void* const data = const_cast<void*>(n.data);
    if (n.type == DType::float32)
      static_cast<float*>(data)[i] = float(x);
    else if (n.type == DType::float64)
      static_cast<double*>(data)[i] = x;
    else if (n.type == DType::float16)
      static_cast<Half*>(data)[i] = round_to_half(float(x));
    else
      static_cast<BFloat16*>(data)[i] = round_to_bfloat16(float(x));
  }

  template <int N>
  __device__ __forceinline__ void read(TypedPointer const& n, int64_t stride, double* x) const {
#pragma unroll
    for (int i = 0; i < N; ++i) x[i] = number(n, b * stride + i);
  }
  // The first `count` numbers; the others are 0.
  template <int N>
  __device__ __forceinline__ void read_first(TypedPointer const& n, int count, double* x) const {
#pragma unroll
    for (int i = 0; i < N; ++i) x[i] = i < count ? number(n, b * count + i) : 0;
  }
  template <int N>
  __device__ __forceinline__ void write(TypedPointer const& n, int count, double const* x) const {
#pragma unroll
    for (int i = 0; i < N; ++i)
      if (i < count) set(n, b * count + i, x[i]);
  }
  __device__ __forceinline__ void write_one(TypedPointer const& n, int64_t width, int i, double x) const {
    set(n, b * width + i, x);
  }
};

template <class F>
__global__ void __launch_bounds__(kThreads) evaluate_all(__grid_constant__ FormulaParams<F> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) evaluate_formula(p, Sample{b});
}

template <class F>
__global__ void __launch_bounds__(kThreads) differentiate_all(__grid_constant__ FormulaParams<F> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) formula_vjp(p, Sample{b});
}

}  // namespace

template <class F>
int formula(FormulaParams<F> const& p, CUstream_st* stream) {
  evaluate_all<<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class F>
int formula_backward(FormulaParams<F> const& p, CUstream_st* stream) {
  differentiate_all<<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::geometry::cuda
