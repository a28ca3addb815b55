// Working memory of one CPU kernel call: a few rows per thread. Included by *_cpu.cpp files.
#pragma once

#include <cstdlib>

#include "hd.h"

namespace kv {

template <class F>
struct Scratch {
  F* data;
  KV_HD explicit Scratch(int64_t count) : data(static_cast<F*>(aligned_alloc(64, (count * sizeof(F) + 63) / 64 * 64))) {
    if (!data) abort();  // a row of the image is in memory already; this is a few more of them
  }
  KV_HD ~Scratch() { free(data); }
  Scratch(Scratch const&) = delete;
  Scratch& operator=(Scratch const&) = delete;
};

}  // namespace kv
