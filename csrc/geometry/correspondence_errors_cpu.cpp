// Errors of correspondences on the CPU: correspondences [begin, end) of all problems, parts of them for the gradient.
// In double, which AVX-512 leaves to AVX2.
#include "geometry/correspondence_errors.h"

#if !defined(__AVX512F__)
namespace kv::KV_ISA {

template <class T>
void view_errors(ViewErrors<T> const& p, int64_t begin, int64_t end) {
  while (begin < end) {
    int64_t const b = begin / p.count, last = min(end, (b + 1) * p.count);
    small::Relation const relation(p, b);
    for (; begin < last; ++begin) view_error_of(p, relation, b, begin - b * p.count);
  }
}

template <class T>
void view_errors_backward(ViewErrors<T> const& p, int64_t begin, int64_t end) {
  for (int64_t item = begin; item < end; ++item) view_errors_backward_of(p, item, Alone{});
}

template <class T>
void view_errors_sums(ViewErrors<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b)
    for (int k = 0; k < 9; ++k) view_errors_sum(p, b, k);
}

KV_INSTANTIATE_ONE(view_errors, ViewErrors, double)
KV_INSTANTIATE_ONE(view_errors_backward, ViewErrors, double)
KV_INSTANTIATE_ONE(view_errors_sums, ViewErrors, double)

}  // namespace kv::KV_ISA
#endif
