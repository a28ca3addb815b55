// Loads and stores of interleaved pixels with three channels, one SIMD vector a channel. Included by *_cpu.cpp files.
//
//   memory  r g b r g b ...      vectors  r r ... | g g ... | b b ...
#pragma once

#include "lanes.h"

namespace kv {

// Lane i of channel k is element 3 i + k of the three vectors in memory. Processors shuffle two vectors at a time.
template <int N, int k, class V, int... i>
KV_HD V deinterleave(V const (&m)[3], std::integer_sequence<int, i...>) {
  V const first = __builtin_shufflevector(m[0], m[1], (3 * i + k < 2 * N ? 3 * i + k : 0)...);
  return __builtin_shufflevector(first, m[2], (3 * i + k < 2 * N ? i : 3 * i + k - N)...);
}
template <int N, int j, class V, int... i>
KV_HD V interleave(V const (&c)[3], std::integer_sequence<int, i...>) {
  V const first = __builtin_shufflevector(c[0], c[1], ((j * N + i) / 3 + (j * N + i) % 3 % 2 * N)...);
  return __builtin_shufflevector(first, c[2], ((j * N + i) % 3 == 2 ? N + (j * N + i) / 3 : i)...);
}

// N pixels, the first at p.
template <int N, class T>
KV_HD void load_interleaved(T const* p, Lanes<Compute<T>, N> (&c)[3]) {
  if constexpr (N == 1) {
    for (int k = 0; k < 3; ++k) c[k] = load<1>(p + k);
  } else {
    constexpr std::make_integer_sequence<int, N> lanes;
    Lanes<Compute<T>, N> const m[] = {load<N>(p), load<N>(p + N), load<N>(p + 2 * N)};
    c[0] = deinterleave<N, 0>(m, lanes);
    c[1] = deinterleave<N, 1>(m, lanes);
    c[2] = deinterleave<N, 2>(m, lanes);
  }
}
template <int N, class T>
KV_HD void store_interleaved(T* p, Lanes<Compute<T>, N> const (&c)[3]) {
  if constexpr (N == 1) {
    for (int k = 0; k < 3; ++k) store<1>(p + k, c[k]);
  } else {
    constexpr std::make_integer_sequence<int, N> lanes;
    store<N>(p, interleave<N, 0>(c, lanes));
    store<N>(p + N, interleave<N, 1>(c, lanes));
    store<N>(p + 2 * N, interleave<N, 2>(c, lanes));
  }
}

}  // namespace kv
