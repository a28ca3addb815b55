// Minimal solvers on CUDA: one thread for each sample, of five points 16.
#include "core/launch.cuh"
#include "geometry/solvers/five_points.h"
#include "geometry/solvers/minimal.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 64;  // few threads, so that a round of hypotheses spreads over the device

template <class T>
__global__ void __launch_bounds__(kThreads) solve_samples(Minimal<T> p) {
  int64_t const sample = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (sample < p.samples) solve_minimal_sample(p, sample);
}

// The indices of the points of a sample, of a number that the compiler knows.
template <int N, class T>
__device__ __forceinline__ bool indices_of(Minimal<T> const& p, int64_t sample, int64_t (&indices)[N]) {
#pragma unroll
  for (int i = 0; i < N; ++i) indices[i] = sample * N + i;
  return !p.draws.data || minimal_solvers::choose_distinct(p, sample, N, indices);
}

// All in registers: 1.15x of a call from solve_samples.
template <class T>
__global__ void __launch_bounds__(kThreads) solve_seven(__grid_constant__ Minimal<T> const p) {
  int64_t const sample = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (sample >= p.samples) return;
  int64_t indices[7];
  bool const exists = indices_of(p, sample, indices);
  double x[7][2], y[7][2], models[3][9];
#pragma unroll
  for (int i = 0; i < 7; ++i)
#pragma unroll
    for (int k = 0; k < 2; ++k) {
      x[i][k] = exists ? p.points1[2 * indices[i] + k] : small::nan();
      y[i][k] = exists ? p.points2[2 * indices[i] + k] : small::nan();
    }
  seven_points::solve<double>(x, y, models);
#pragma unroll
  for (int c = 0; c < 3; ++c)
#pragma unroll
    for (int k = 0; k < 9; ++k) p.models.set((sample * 3 + c) * 9 + k, models[c][k]);
}

// Half a warp.
struct HalfWarp {
  __device__ __forceinline__ int rank() const { return int(threadIdx.x) % five_points::kGroup; }
  template <class V>
  __device__ __forceinline__ V from(V x, int rank) const {
    return __shfl_sync(0xffffffffu, x, rank, five_points::kGroup);
  }
  __device__ __forceinline__ unsigned max(unsigned x) const {
#pragma unroll
    for (int k = five_points::kGroup / 2; k > 0; k /= 2) x = kv::max(x, __shfl_xor_sync(0xffffffffu, x, k));
    return x;
  }
  __device__ __forceinline__ bool any(bool x) const { return __any_sync(0xffffffffu, x); }
  __device__ __forceinline__ void sync() const { __syncwarp(); }
};

constexpr int kFiveThreads = 128;

template <class T>
__global__ void __launch_bounds__(kFiveThreads, 6) solve_five(__grid_constant__ Minimal<T> const p) {
  __shared__ five_points::Scratch scratch[kFiveThreads / five_points::kGroup];
  HalfWarp const group;
  five_points::Scratch& s = scratch[threadIdx.x / five_points::kGroup];
  int64_t const at = (blockIdx.x * int64_t(kFiveThreads) + threadIdx.x) / five_points::kGroup;
  int64_t const sample = min(at, p.samples - 1);  // all threads of a warp take part
  int const rank = group.rank();
  int64_t indices[5], own = 0;
  bool const exists = indices_of(p, sample, indices);
#pragma unroll
  for (int i = 0; i < 5; ++i) own = rank == i ? indices[i] : own;
  double x[2], y[2], m[9];
#pragma unroll
  for (int k = 0; k < 2; ++k) {
    x[k] = exists ? p.points1[2 * own + k] : small::nan();
    y[k] = exists ? p.points2[2 * own + k] : small::nan();
  }
  five_points::solve(x, y, s, m, group);
  double* const models = &s.quadratics[0][0];
  if (rank < 10)
#pragma unroll
    for (int k = 0; k < 9; ++k) models[9 * rank + k] = m[k];
  group.sync();
  if (at < p.samples)
    for (int i = rank; i < 90; i += five_points::kGroup) p.models.set(sample * 90 + i, models[i]);
}

}  // namespace

template <class T>
int minimal_solver(Minimal<T> const& p, CUstream_st* stream) {
  auto const blocks = [&](int64_t threads, int size) { return unsigned(ceil_div(threads, size)); };
  if (p.model == Model::essential)
    solve_five<T><<<blocks(p.samples * five_points::kGroup, kFiveThreads), kFiveThreads, 0, stream>>>(p);
  else if (p.model == Model::fundamental)
    solve_seven<T><<<blocks(p.samples, kThreads), kThreads, 0, stream>>>(p);
  else
    solve_samples<T><<<blocks(p.samples, kThreads), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(minimal_solver, Minimal, double)

}  // namespace kv::geometry::cuda
