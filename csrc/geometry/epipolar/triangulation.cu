// Triangulation on CUDA: one thread for each point, one block for each chunk of points for the gradient.
#include "core/launch.cuh"
#include "geometry/epipolar/triangulation.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) triangulate_points(Triangulate<T> p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < p.batch * p.count) triangulate_item(p, i);
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) differentiate_chunks(__grid_constant__ Triangulate<T> const p) {
  triangulate_chunk_vjp(p, blockIdx.x, ThreadBlock{});
}

template <class T>
__global__ void add_chunks(__grid_constant__ Triangulate<T> const p) {
  sum_chunks(p, blockIdx.x, threadIdx.x);
}

}  // namespace

template <class T>
int triangulate(Triangulate<T> const& p, CUstream_st* stream) {
  triangulate_points<T><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int triangulate_backward(Triangulate<T> const& p, CUstream_st* stream) {
  differentiate_chunks<T><<<unsigned(p.batch * p.num_chunks()), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int triangulate_sums(Triangulate<T> const& p, CUstream_st* stream) {
  add_chunks<T><<<unsigned(p.batch), 24, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(triangulate, Triangulate, double)
KV_INSTANTIATE_ONE(triangulate_backward, Triangulate, double)
KV_INSTANTIATE_ONE(triangulate_sums, Triangulate, double)

}  // namespace kv::geometry::cuda
