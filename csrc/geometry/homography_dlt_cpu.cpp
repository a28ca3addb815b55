// Homographies from points on the CPU: problems [begin, end). In double, which AVX-512 leaves to AVX2.
#include "homography_dlt.h"

#if !defined(__AVX512F__)
namespace kv::KV_ISA {

template <class T>
void homography_dlt(HomographyDlt<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) homography_dlt_of(p, b, Alone{});
}

template <class T>
void homography_dlt_backward(HomographyDlt<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) homography_dlt_backward_of(p, b, Alone{});
}

KV_INSTANTIATE_ONE(homography_dlt, HomographyDlt, double)
KV_INSTANTIATE_ONE(homography_dlt_backward, HomographyDlt, double)

}  // namespace kv::KV_ISA
#endif
