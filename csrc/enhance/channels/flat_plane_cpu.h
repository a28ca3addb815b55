// The pixels of a plane that is one row, on the CPU. Included by *_cpu.cpp files.
#pragma once

#include "core/lanes.h"

namespace kv::enhance::KV_ISA {
namespace {

// Calls f(index constant N, element) for n pixels with stride `step`: whole vectors, then single elements.
template <class T, class F>
KV_HD void for_each_pixel(int64_t n, int64_t step, F f) {
  constexpr int N = kLanes<T>;
  int64_t i = 0;
  if (step == 1)
    for (; i + N <= n; i += N) f(Width<N>{}, i);
  for (; i < n; ++i) f(Width<1>{}, i * step);
}

}  // namespace
}  // namespace kv::enhance::KV_ISA
