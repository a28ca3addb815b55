// Homographies from points on CUDA: a warp a problem.
#include "core/launch.cuh"
#include "homography_dlt.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 64;

template <class T>
__global__ void __launch_bounds__(kThreads) find_homographies(HomographyDlt<T> p) {
  int64_t const b = blockIdx.x * int64_t(kThreads / 32) + threadIdx.x / 32;
  if (b < p.batch) homography_dlt_of(p, b, Warp{});
}

template <class T>
__global__ void __launch_bounds__(kThreads) find_homographies_backward(HomographyDlt<T> p) {
  int64_t const b = blockIdx.x * int64_t(kThreads / 32) + threadIdx.x / 32;
  if (b < p.batch) homography_dlt_backward_of(p, b, Warp{});
}

}  // namespace

template <class T>
int homography_dlt(HomographyDlt<T> const& p, CUstream_st* stream) {
  find_homographies<T><<<unsigned(ceil_div(p.batch, kThreads / 32)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int homography_dlt_backward(HomographyDlt<T> const& p, CUstream_st* stream) {
  find_homographies_backward<T><<<unsigned(ceil_div(p.batch, kThreads / 32)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(homography_dlt, HomographyDlt, double)
KV_INSTANTIATE_ONE(homography_dlt_backward, HomographyDlt, double)

}  // namespace kv::cuda
