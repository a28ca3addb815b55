// Histograms of 8-bit levels on the CPU, computed in chunks of a plane. Included by *_cpu.cpp files.
#pragma once

#include "byte_histogram.h"
#include "core/bytes.h"

namespace kv::enhance::KV_ISA {
namespace {

constexpr int64_t kChunk = 512;  // pixels
template <class T>
constexpr int kWhite = __is_same(T, uint8_t) ? 1 : 255;  // levels are divided by it

template <class T, int N>
KV_HD Lanes<int32_t, N> levels_of(Lanes<Compute<T>, N> x) {
  using F = Compute<T>;
  if constexpr (__is_same(T, uint8_t)) {
    if constexpr (N == 1)
      return int32_t(x);
    else
      return __builtin_convertvector(x, Lanes<int32_t, N>);
  }
  auto const is_nan = x != x;
  x = (x > 0 ? x : broadcast<N>(F(0))) * 255;
  if constexpr (sizeof(T) == 2) {
    T stored[N];
    store<N>(stored, x);
    x = load<N>(stored);
  }
  x = min(x, broadcast<N>(F(255)));
  if constexpr (N == 1)
    return is_nan ? kNanLevel : int32_t(x);
  else
    return __builtin_convertvector(is_nan ? broadcast<N>(F(kNanLevel)) : x, Lanes<int32_t, N>);
}

// Quantizes n <= kChunk pixels with stride `step` to contiguous levels.
template <class T>
KV_HD T const* gather(T const* x, int64_t step, int64_t n, T* memory) {
  if (step == 1) return x;
  for (int64_t i = 0; i < n; ++i) memory[i] = x[i * step];
  return memory;
}

template <class T>
KV_HD void levels_of(T const* x, int64_t n, uint16_t* level) {
  if constexpr (__is_same(T, uint8_t))
    return for_each_vector<uint8_t, kByteLanes / 2>(0, n, [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      if constexpr (N == 1)
        level[i] = x[i];
      else
        write_lanes<N>(level + i, __builtin_bit_cast(Lanes<uint16_t, N>, load_words<N>(x + i)));
    });
  for_each_vector<T>(0, n, [&](auto width, int64_t i) {
    constexpr int N = decltype(width)::value;
    auto const v = levels_of<T, N>(load<N>(x + i));
    if constexpr (N == 1)
      level[i] = uint16_t(v);
    else
      write_lanes<N>(level + i, __builtin_convertvector(v, Lanes<uint16_t, N>));
  });
}

// Counts levels in four tables in turn: increments of one counter in a row would each wait for the one before.
struct LevelCounts {
  int32_t of[4][kLevels + 1];
  template <class L>
  KV_HD void add(L const* level, int64_t n, int64_t step = 1) {
    int64_t i = 0;
    for (; i + 4 <= n; i += 4)
      for (int k = 0; k < 4; ++k) ++of[k][level[(i + k) * step]];
    for (; i < n; ++i) ++of[0][level[i * step]];
  }
  KV_HD void sum_up(int32_t (&count)[kLevels]) const {
    auto const row = [&](int k, int i) { return read_lanes<8>(of[k] + i); };
    for (int i = 0; i < kLevels; i += 8) write_lanes<8>(count + i, row(0, i) + row(1, i) + row(2, i) + row(3, i));
  }
};

}  // namespace
}  // namespace kv::enhance::KV_ISA
