// Direct linear transformation on the CPU: problems [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/solvers/dlt.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void dlt(Dlt<T> const& p, int64_t begin, int64_t end) {
  dispatch_model(p.model, [&](auto model) {
    for (int64_t b = begin; b < end; ++b) solve_dlt(model, p, b, SingleThread{});
  });
}

template <class T>
void dlt_backward(Dlt<T> const& p, int64_t begin, int64_t end) {
  dispatch_model(p.model, [&](auto model) {
    for (int64_t b = begin; b < end; ++b) solve_dlt_vjp(model, p, b, SingleThread{});
  });
}

template <class T>
void normalize_points(NormalizedPoints<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) normalize_problem(p, b, SingleThread{});
}

template <class T>
void normalize_points_backward(NormalizedPoints<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) normalize_problem_vjp(p, b, SingleThread{});
}

KV_INSTANTIATE_ONE(dlt, Dlt, double)
KV_INSTANTIATE_ONE(dlt_backward, Dlt, double)
KV_INSTANTIATE_ONE(normalize_points, NormalizedPoints, double)
KV_INSTANTIATE_ONE(normalize_points_backward, NormalizedPoints, double)

}  // namespace kv::geometry::KV_ISA
#endif
