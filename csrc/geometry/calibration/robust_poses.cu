// Robust poses on CUDA: one block for each problem, whose threads score hypotheses and then share correspondences.
#include "core/launch.cuh"
#include "geometry/calibration/robust_poses.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 128;
static_assert(kThreads <= kMaxThreads && kThreads <= robust_pose::kMaxGroupThreads);

template <class T>
__global__ void __launch_bounds__(kThreads) solve_problems(__grid_constant__ RobustPoses<T> const p) {
  fit_robust_pose(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int robust_poses(RobustPoses<T> const& p, CUstream_st* stream) {
  solve_problems<T><<<unsigned(p.fit.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(robust_poses, RobustPoses, double)

}  // namespace kv::geometry::cuda
