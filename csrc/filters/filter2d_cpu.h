// Shared by filter2d_cpu.cpp and filter2d_kernel_backward_cpu.cpp: unrolled loops, and rows with their borders.
// Compiled once per instruction set.
#pragma once

#include "core/lanes.h"
#include "core/scratch.h"
#include "filter2d.h"

namespace kv::filters::KV_ISA {
namespace {

// Calls f(Width<0>{}) ... f(Width<N - 1>{}). Loops that are unrolled this early let the compiler keep the arrays that
// they index in registers.
template <int N, class F>
KV_HD void unroll(F f) {
  if constexpr (N > 0) {
    unroll<N - 1>(f);
    f(Width<N - 1>{});
  }
}

// Copies the pixels first ... first + count - 1 of row y of a plane. Row and pixels may be out of bounds.
template <class T>
KV_HD void copy_pixels(Planes<T const> const& x, int64_t plane, int64_t y, Border border, int64_t first, int64_t count,
                       Compute<T>* to) {
  int64_t const step = x.step, source = border_index(border, y, x.height);
  if (source < 0) {
    for (int64_t e = 0; e < count * step; ++e) to[e] = 0;
    return;
  }
  T const* const row = x.row(plane, source);
  to -= first * step;  // where pixel 0 would be
  auto const copy_border = [&](int64_t from, int64_t to_pixel) {
    for (int64_t pixel = from; pixel < to_pixel; ++pixel) {
      int64_t const i = border_index(border, pixel, x.width);
      for (int64_t c = 0; c < step; ++c) to[pixel * step + c] = i < 0 ? Compute<T>(0) : load<1>(row + i * step + c);
    }
  };
  int64_t const last = first + count;
  copy_border(first, min(last, int64_t(0)));
  for_each_vector<T>(max(first, int64_t(0)) * step, min(last, x.width) * step, [&](auto lanes, int64_t e) {
    constexpr int N = decltype(lanes)::value;
    store<N>(to + e, load<N>(row + e));
  });
  copy_border(max(first, x.width), last);
}

}  // namespace
}  // namespace kv::filters::KV_ISA
