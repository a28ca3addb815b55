// Poses of samples on the CPU: samples [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/calibration/sample_poses.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void sample_poses(SamplePoses<T> const& p, int64_t begin, int64_t end) {
  for (int64_t at = begin; at < end; ++at) solve_sample(p, at);
}

KV_INSTANTIATE_ONE(sample_poses, SamplePoses, double)

}  // namespace kv::geometry::KV_ISA
#endif
