// Consecutive numbers, one a lane. Included by *_cpu.cpp files and their headers.
#pragma once

#include "lanes.h"

namespace kv {

template <int N, class F>
KV_HD Lanes<F, N> iota(int64_t first) {
  if constexpr (N == 1) {
    return F(first);
  } else {
    Lanes<F, N> v;
    for (int i = 0; i < N; ++i) v[i] = F(i);
    return v + F(first);
  }
}

}  // namespace kv
