// Real roots on the CPU: polynomials [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/solvers/roots.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void real_roots(RealRoots<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) sorted_real_roots(p, b);
}

template <class T>
void first_root(RealRoots<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) set_first_root(p, b);
}

KV_INSTANTIATE_ONE(real_roots, RealRoots, double)
KV_INSTANTIATE_ONE(first_root, RealRoots, double)

}  // namespace kv::geometry::KV_ISA
#endif
