// Working memory of one CPU kernel call: a few rows per thread. Included by *_cpu.cpp files.
#pragma once

#include <cstdlib>

#include "hd.h"

namespace kv {

// Starts at a cache line. Not by aligned_alloc: what glibc cuts off for it stays behind in small pieces, which keep the
// image that was allocated before from joining the free memory again, so that the next call gets pages never touched.
template <class F>
struct Scratch {
  void* memory;
  F* data;
  KV_HD explicit Scratch(int64_t count) : memory(malloc(count * sizeof(F) + 63)) {
    if (!memory) abort();  // a row of the image is in memory already; this is a few more of them
    data = reinterpret_cast<F*>((reinterpret_cast<uintptr_t>(memory) + 63) & ~uintptr_t(63));
  }
  KV_HD ~Scratch() { free(memory); }
  Scratch(Scratch const&) = delete;
  Scratch& operator=(Scratch const&) = delete;
};

}  // namespace kv
