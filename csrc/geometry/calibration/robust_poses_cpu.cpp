// Robust poses on the CPU: problems [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/calibration/robust_poses.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void robust_poses(RobustPoses<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) fit_robust_pose(p, b, SingleThread{});
}

KV_INSTANTIATE_ONE(robust_poses, RobustPoses, double)

}  // namespace kv::geometry::KV_ISA
#endif
