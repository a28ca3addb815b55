// Minimal solvers on the CPU: samples [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/solvers/minimal.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void minimal_solver(Minimal<T> const& p, int64_t begin, int64_t end) {
  for (int64_t sample = begin; sample < end; ++sample) solve_minimal_sample(p, sample);
}

KV_INSTANTIATE_ONE(minimal_solver, Minimal, double)

}  // namespace kv::geometry::KV_ISA
#endif
