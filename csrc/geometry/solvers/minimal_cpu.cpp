// Minimal solvers on the CPU: samples [begin, end), those of seven points in vectors. In double: the AVX-512 build uses
// the AVX2 code.
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "geometry/solvers/minimal.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void minimal_solver(Minimal<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<double>;
  if (p.model == Model::fundamental)
    for (int64_t first = begin; first < end; first += N)
      solve_seven_points<Lanes<double, N>>(p, first, int(min(end - first, int64_t(N))));
  else
    for (int64_t sample = begin; sample < end; ++sample) solve_minimal_sample(p, sample);
}

KV_INSTANTIATE_ONE(minimal_solver, Minimal, double)

}  // namespace kv::geometry::KV_ISA
#endif
