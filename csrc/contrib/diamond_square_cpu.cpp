// A step of the diamond-square algorithm on the CPU: rows [begin, end) of all planes. Compiled once per instruction
// set.
#include "contrib/diamond_square.h"
#include "core/lanes.h"

namespace kv::contrib::KV_ISA {

template <class T>
void refine_fractal(RefineFractal<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const y = r % p.height();
    auto const plane = fractal_plane(p, r / p.height(), [](T const* x) { return load<1>(x); });
    for (int64_t x = 0; x < p.width(); ++x) store<1>(p.fine + r * p.width() + x, Lanes<Compute<T>, 1>(plane.at(y, x)));
  }
}

KV_INSTANTIATE(refine_fractal, RefineFractal)

}  // namespace kv::contrib::KV_ISA
