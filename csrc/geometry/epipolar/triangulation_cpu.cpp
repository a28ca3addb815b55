// Triangulation on the CPU: points [begin, end) of all problems. In double, which AVX-512 leaves to AVX2.
#include "geometry/epipolar/triangulation.h"

#if !defined(__AVX512F__)
namespace kv::KV_ISA {

template <class T>
void triangulate(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) triangulate_of(p, i);
}

template <class T>
void triangulate_backward(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t item = begin; item < end; ++item) triangulate_backward_of(p, item, Alone{});
}

template <class T>
void triangulate_sums(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b)
    for (int k = 0; k < 24; ++k) triangulate_sum(p, b, k);
}

KV_INSTANTIATE_ONE(triangulate, Triangulate, double)
KV_INSTANTIATE_ONE(triangulate_backward, Triangulate, double)
KV_INSTANTIATE_ONE(triangulate_sums, Triangulate, double)

}  // namespace kv::KV_ISA
#endif
