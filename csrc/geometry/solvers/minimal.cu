// Minimal solvers on CUDA: one thread for each sample.
#include "core/launch.cuh"
#include "geometry/solvers/minimal.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 64;  // few threads, so that a round of hypotheses spreads over the device

template <class T>
__global__ void __launch_bounds__(kThreads) solve_samples(Minimal<T> p) {
  int64_t const sample = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (sample < p.samples) solve_minimal_sample(p, sample);
}

}  // namespace

template <class T>
int minimal_solver(Minimal<T> const& p, CUstream_st* stream) {
  solve_samples<T><<<unsigned(ceil_div(p.samples, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(minimal_solver, Minimal, double)

}  // namespace kv::geometry::cuda
