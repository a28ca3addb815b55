// Homographies from points on CUDA: a block a problem.
#include "core/launch.cuh"
#include "homography_dlt.h"

namespace kv::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kMostThreads) find_homographies(HomographyDlt<T> p) {
  homography_dlt_of(p, blockIdx.x, Block{});
}

template <class T>
__global__ void __launch_bounds__(kMostThreads) find_homographies_backward(HomographyDlt<T> p) {
  homography_dlt_backward_of(p, blockIdx.x, Block{});
}

}  // namespace

template <class T>
int homography_dlt(HomographyDlt<T> const& p, CUstream_st* stream) {
  find_homographies<T><<<unsigned(p.batch), team_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int homography_dlt_backward(HomographyDlt<T> const& p, CUstream_st* stream) {
  find_homographies_backward<T><<<unsigned(p.batch), team_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(homography_dlt, HomographyDlt, double)
KV_INSTANTIATE_ONE(homography_dlt_backward, HomographyDlt, double)

}  // namespace kv::cuda
