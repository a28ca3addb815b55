// Errors of correspondences on CUDA: a thread a correspondence, a block a part of them for the gradient.
#include "core/launch.cuh"
#include "geometry/correspondence_errors.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) find_errors(__grid_constant__ ViewErrors<T> const p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= p.batch * p.count) return;
  int64_t const b = i / p.count;
  view_error_of(p, small::Relation(p, b), b, i - b * p.count);
}

template <class T>
__global__ void __launch_bounds__(kMostThreads) find_slopes(__grid_constant__ ViewErrors<T> const p) {
  view_errors_backward_of(p, blockIdx.x, Block{});
}

template <class T>
__global__ void add_parts(__grid_constant__ ViewErrors<T> const p) {
  view_errors_sum(p, blockIdx.x, threadIdx.x);
}

}  // namespace

template <class T>
int view_errors(ViewErrors<T> const& p, CUstream_st* stream) {
  find_errors<T><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int view_errors_backward(ViewErrors<T> const& p, CUstream_st* stream) {
  find_slopes<T><<<unsigned(p.batch * p.part_count()), team_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int view_errors_sums(ViewErrors<T> const& p, CUstream_st* stream) {
  add_parts<T><<<unsigned(p.batch), 9, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(view_errors, ViewErrors, double)
KV_INSTANTIATE_ONE(view_errors_backward, ViewErrors, double)
KV_INSTANTIATE_ONE(view_errors_sums, ViewErrors, double)

}  // namespace kv::cuda
