// Triangulation on the CPU: points [begin, end) of all problems. In double, which AVX-512 leaves to AVX2.
#include "triangulate.h"

#if !defined(__AVX512F__)
namespace kv::KV_ISA {

template <class T>
void triangulate(Triangulate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) triangulate_of(p, i);
}

KV_INSTANTIATE_ONE(triangulate, Triangulate, double)

}  // namespace kv::KV_ISA
#endif
