// Reprojections on the CPU: samples [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/depth/reprojection.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void reprojection(ReprojectionParams<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) set_reprojection(p, b);
}

template <class T>
void reprojection_backward(ReprojectionParams<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) reprojection_vjp(p, b);
}

KV_INSTANTIATE_ONE(reprojection, ReprojectionParams, double)
KV_INSTANTIATE_ONE(reprojection_backward, ReprojectionParams, double)

}  // namespace kv::geometry::KV_ISA
#endif
