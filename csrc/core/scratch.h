// Working memory of one CPU kernel call: a few rows per thread. Included by *_cpu.cpp files.
#pragma once

#include <cstdlib>

#include "hd.h"

namespace kv {

// Aligned to a cache line. aligned_alloc is not used: glibc leaves small free blocks behind it, which fragment the
// heap, so that the next large result is placed in pages that fault again.
template <class F>
struct Scratch {
  void* memory;
  F* data;
  KV_HD explicit Scratch(int64_t count) : memory(malloc(count * sizeof(F) + 63)) {
    if (!memory) abort();  // a few rows; an image that is in memory has many more
    data = reinterpret_cast<F*>((reinterpret_cast<uintptr_t>(memory) + 63) & ~uintptr_t(63));
  }
  KV_HD ~Scratch() { free(memory); }
  Scratch(Scratch const&) = delete;
  Scratch& operator=(Scratch const&) = delete;
};

}  // namespace kv
