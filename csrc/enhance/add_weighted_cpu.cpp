// CPU kernel for add_weighted. Compiled once per instruction set.
#include "add_weighted.h"
#include "core/ceil_div.h"
#include "core/lanes.h"

namespace kv::enhance::KV_ISA {

template <class T>
void add_weighted(AddWeighted<T> const& p, int64_t begin, int64_t end) {
  int64_t const width = p.x.width, step = p.x.step, chunks = ceil_div(width, kAddWeightedChunk);
  for (; begin < end; ++begin) {
    int64_t const plane = begin / chunks, first = begin % chunks * kAddWeightedChunk,
                  last = min(first + kAddWeightedChunk, width);
    auto const a = p.weight_of(p.alpha, plane), b = p.weight_of(p.beta, plane), c = p.weight_of(p.gamma, plane);
    T const *const x = p.x.plane(plane), *const y = p.y.plane(plane);
    T* const result = p.result.plane(plane);
    auto const pixels = [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      store<N>(result + i, Lanes<Compute<T>, N>(load<N>(x + i) * a + load<N>(y + i) * b + c));
    };
    if (step == 1)
      for_each_vector<T>(first, last, pixels);
    else
      for (int64_t i = first; i < last; ++i) pixels(Width<1>{}, i * step);
  }
}

KV_INSTANTIATE(add_weighted, AddWeighted)

}  // namespace kv::enhance::KV_ISA
