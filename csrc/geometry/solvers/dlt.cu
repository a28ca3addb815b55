// Direct linear transformation on CUDA: a block a problem.
#include "core/launch.cuh"
#include "geometry/solvers/dlt.h"

namespace kv::cuda {
namespace {

template <class Model, class T>
__global__ void __launch_bounds__(kMostThreads) find_models(__grid_constant__ Dlt<T> const p) {
  dlt_of(Model{}, p, blockIdx.x, Block{});
}

template <class Model, class T>
__global__ void __launch_bounds__(kMostThreads) find_models_backward(__grid_constant__ Dlt<T> const p) {
  dlt_backward_of(Model{}, p, blockIdx.x, Block{});
}

template <class T>
__global__ void __launch_bounds__(kMostThreads) normalize_all(__grid_constant__ NormalizedPoints<T> const p) {
  normalize_points_of(p, blockIdx.x, Block{});
}

template <class T>
__global__ void __launch_bounds__(kMostThreads) normalize_all_backward(__grid_constant__ NormalizedPoints<T> const p) {
  normalize_points_backward_of(p, blockIdx.x, Block{});
}

}  // namespace

template <class T>
int dlt(Dlt<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = team_size(p.count);
  with_model(p.model, [&](auto model) { find_models<decltype(model)><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int dlt_backward(Dlt<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch), threads = team_size(p.count);
  with_model(p.model, [&](auto model) { find_models_backward<decltype(model)><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int normalize_points(NormalizedPoints<T> const& p, CUstream_st* stream) {
  normalize_all<T><<<unsigned(p.batch), team_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int normalize_points_backward(NormalizedPoints<T> const& p, CUstream_st* stream) {
  normalize_all_backward<T><<<unsigned(p.batch), team_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(dlt, Dlt, double)
KV_INSTANTIATE_ONE(dlt_backward, Dlt, double)
KV_INSTANTIATE_ONE(normalize_points, NormalizedPoints, double)
KV_INSTANTIATE_ONE(normalize_points_backward, NormalizedPoints, double)

}  // namespace kv::cuda
