// Poses of samples on CUDA: one thread for each sample.
#include "core/launch.cuh"
#include "geometry/calibration/sample_poses.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 64;

template <class T>
__global__ void __launch_bounds__(kThreads) solve_samples(__grid_constant__ SamplePoses<T> const p) {
  int64_t const at = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (at < p.batch * p.num_samples) solve_sample(p, at);
}

}  // namespace

template <class T>
int sample_poses(SamplePoses<T> const& p, CUstream_st* stream) {
  solve_samples<T><<<unsigned(ceil_div(p.batch * p.num_samples, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(sample_poses, SamplePoses, double)

}  // namespace kv::geometry::cuda
