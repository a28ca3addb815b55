// Poses with the least reprojection error on the CPU: problems [begin, end). In double: the AVX-512 build uses the AVX2
// code.
#include "geometry/optim/fit_poses.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void fit_poses(FitPoses<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) fit_pose(p, b, SingleThread{});
}

KV_INSTANTIATE_ONE(fit_poses, FitPoses, double)

}  // namespace kv::geometry::KV_ISA
#endif
