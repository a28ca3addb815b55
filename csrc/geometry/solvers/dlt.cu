// Direct linear transformation on CUDA: one block for each problem.
#include "core/launch.cuh"
#include "geometry/solvers/dlt.h"

namespace kv::geometry::cuda {
namespace {

template <class Model, class T>
__global__ void __launch_bounds__(kMaxThreads) solve_problems(__grid_constant__ Dlt<T> const p) {
  solve_dlt(Model{}, p, blockIdx.x, ThreadBlock{});
}

template <class Model, class T>
__global__ void __launch_bounds__(kMaxThreads) solve_problems_vjp(__grid_constant__ Dlt<T> const p) {
  solve_dlt_vjp(Model{}, p, blockIdx.x, ThreadBlock{});
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) normalize_problems(__grid_constant__ NormalizedPoints<T> const p) {
  normalize_problem(p, blockIdx.x, ThreadBlock{});
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) normalize_problems_vjp(__grid_constant__ NormalizedPoints<T> const p) {
  normalize_problem_vjp(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int dlt(Dlt<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = block_size(p.count);
  dispatch_model(p.model, [&](auto model) { solve_problems<decltype(model)><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int dlt_backward(Dlt<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = block_size(p.count);
  dispatch_model(p.model, [&](auto model) { solve_problems_vjp<decltype(model)><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int normalize_points(NormalizedPoints<T> const& p, CUstream_st* stream) {
  normalize_problems<T><<<unsigned(p.batch), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int normalize_points_backward(NormalizedPoints<T> const& p, CUstream_st* stream) {
  normalize_problems_vjp<T><<<unsigned(p.batch), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(dlt, Dlt, double)
KV_INSTANTIATE_ONE(dlt_backward, Dlt, double)
KV_INSTANTIATE_ONE(normalize_points, NormalizedPoints, double)
KV_INSTANTIATE_ONE(normalize_points_backward, NormalizedPoints, double)

}  // namespace kv::geometry::cuda
