// Triangulation on the CPU: points [begin, end) of all problems. In double: the AVX-512 build uses the AVX2 code.
#include "geometry/epipolar/triangulation.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void triangulate(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) triangulate_item(p, i);
}

template <class T>
void triangulate_backward(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t chunk = begin; chunk < end; ++chunk) triangulate_chunk_vjp(p, chunk, SingleThread{});
}

template <class T>
void triangulate_sums(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b)
    for (int k = 0; k < 24; ++k) sum_chunks(p, b, k);
}

KV_INSTANTIATE_ONE(triangulate, Triangulate, double)
KV_INSTANTIATE_ONE(triangulate_backward, Triangulate, double)
KV_INSTANTIATE_ONE(triangulate_sums, Triangulate, double)

}  // namespace kv::geometry::KV_ISA
#endif
