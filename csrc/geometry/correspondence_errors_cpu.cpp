// Errors of correspondences on the CPU: correspondences [begin, end) of all problems, chunks of them for the gradient.
// In double: the AVX-512 build uses the AVX2 code.
#include "geometry/correspondence_errors.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void correspondence_errors(CorrespondenceErrors<T> const& p, int64_t begin, int64_t end) {
  while (begin < end) {
    int64_t const b = begin / p.count, last = min(end, (b + 1) * p.count);
    small::ErrorModel const model(p, b);
    for (; begin < last; ++begin) set_error(p, model, b, begin - b * p.count);
  }
}

template <class T>
void correspondence_errors_backward(CorrespondenceErrors<T> const& p, int64_t begin, int64_t end) {
  for (int64_t chunk = begin; chunk < end; ++chunk) differentiate_chunk(p, chunk, SingleThread{});
}

template <class T>
void correspondence_errors_sums(CorrespondenceErrors<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b)
    for (int k = 0; k < 9; ++k) sum_error_chunks(p, b, k);
}

KV_INSTANTIATE_ONE(correspondence_errors, CorrespondenceErrors, double)
KV_INSTANTIATE_ONE(correspondence_errors_backward, CorrespondenceErrors, double)
KV_INSTANTIATE_ONE(correspondence_errors_sums, CorrespondenceErrors, double)

}  // namespace kv::geometry::KV_ISA
#endif
