// Errors of correspondences on CUDA: one thread for each correspondence, one block for each chunk for the gradient.
#include "core/launch.cuh"
#include "geometry/correspondence_errors.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) set_errors(__grid_constant__ CorrespondenceErrors<T> const p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= p.batch * p.count) return;
  int64_t const b = i / p.count;
  set_error(p, small::ErrorModel(p, b), b, i - b * p.count);
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) differentiate_chunks(__grid_constant__ CorrespondenceErrors<T> const p) {
  differentiate_chunk(p, blockIdx.x, ThreadBlock{});
}

template <class T>
__global__ void add_chunks(__grid_constant__ CorrespondenceErrors<T> const p) {
  sum_error_chunks(p, blockIdx.x, threadIdx.x);
}

}  // namespace

template <class T>
int correspondence_errors(CorrespondenceErrors<T> const& p, CUstream_st* stream) {
  set_errors<T><<<unsigned(ceil_div(p.batch * p.count, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int correspondence_errors_backward(CorrespondenceErrors<T> const& p, CUstream_st* stream) {
  differentiate_chunks<T><<<unsigned(p.batch * p.num_chunks()), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int correspondence_errors_sums(CorrespondenceErrors<T> const& p, CUstream_st* stream) {
  add_chunks<T><<<unsigned(p.batch), 9, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(correspondence_errors, CorrespondenceErrors, double)
KV_INSTANTIATE_ONE(correspondence_errors_backward, CorrespondenceErrors, double)
KV_INSTANTIATE_ONE(correspondence_errors_sums, CorrespondenceErrors, double)

}  // namespace kv::geometry::cuda
