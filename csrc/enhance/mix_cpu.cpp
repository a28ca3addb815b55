// Mixing two images on the CPU. Compiled once per instruction set.
#include "core/lanes.h"
#include "mix.h"

namespace kv::KV_ISA {

template <class T>
void mix(Mix<T> const& p, int64_t begin, int64_t end) {
  int64_t const width = p.x.width, step = p.x.step, chunks = (width + kMixed - 1) / kMixed;
  for (; begin < end; ++begin) {
    int64_t const plane = begin / chunks, first = begin % chunks * kMixed, last = min(first + kMixed, width);
    auto const a = p.weight_of(p.alpha, plane), b = p.weight_of(p.beta, plane), c = p.weight_of(p.gamma, plane);
    T const *const x = p.x.plane(plane), *const y = p.y.plane(plane);
    T* const mixed = p.mixed.plane(plane);
    auto const pixels = [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      store<N>(mixed + i, Lanes<Compute<T>, N>(load<N>(x + i) * a + load<N>(y + i) * b + c));
    };
    if (step == 1)
      for_each_vector<T>(first, last, pixels);
    else
      for (int64_t i = first; i < last; ++i) pixels(Width<1>{}, i * step);
  }
}

KV_INSTANTIATE(mix, Mix)

}  // namespace kv::KV_ISA
