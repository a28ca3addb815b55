// Poses with the least reprojection error on CUDA: one block for each problem.
#include "core/launch.cuh"
#include "geometry/optim/fit_poses.h"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kMaxThreads) solve_problems(__grid_constant__ FitPoses<T> const p) {
  fit_pose(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int fit_poses(FitPoses<T> const& p, CUstream_st* stream) {
  solve_problems<T><<<unsigned(p.batch), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(fit_poses, FitPoses, double)

}  // namespace kv::geometry::cuda
