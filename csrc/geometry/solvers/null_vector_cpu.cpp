// Null vectors on the CPU: problems [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/solvers/null_vector.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void null_vector(NullVector<T> const& p, int64_t begin, int64_t end) {
  dispatch_unknowns(p.n, [&](auto n) {
    for (int64_t b = begin; b < end; ++b) solve_null_vector<decltype(n)::value>(p, b, SingleThread{});
  });
}

template <class T>
void null_vector_backward(NullVector<T> const& p, int64_t begin, int64_t end) {
  dispatch_unknowns(p.n, [&](auto n) {
    for (int64_t b = begin; b < end; ++b) null_vector_vjp<decltype(n)::value>(p, b, SingleThread{});
  });
}

template <class T>
void eigenvectors(Eigenvectors<T> const& p, int64_t begin, int64_t end) {
  dispatch_unknowns(p.n, [&](auto n) {
    for (int64_t b = begin; b < end; ++b) solve_eigenvectors<decltype(n)::value>(p, b);
  });
}

KV_INSTANTIATE_ONE(null_vector, NullVector, double)
KV_INSTANTIATE_ONE(null_vector_backward, NullVector, double)
KV_INSTANTIATE_ONE(eigenvectors, Eigenvectors, double)

}  // namespace kv::geometry::KV_ISA
#endif
