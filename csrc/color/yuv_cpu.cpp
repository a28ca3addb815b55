// YUV 4:2:2 and 4:2:0 on the CPU: a row of cells at a time, with sums of columns in a scratch row. Compiled once per
// instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "yuv.h"

namespace kv::color::KV_ISA {

template <class T>
void split_chroma(SplitChroma<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.colors.width, height = p.chroma.height;
  Scratch<F> scratch(2 * width);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const b = i / height, y = i % height;
    for (int r = 0; r < p.rows; ++r) {
      T const* c[3];
      for (int k = 0; k < 3; ++k) c[k] = p.colors.row(3 * b + k, y * p.rows + r);
      T* const luma = p.luma.row(b, y * p.rows + r);
      // No vectors that overlap: the second row adds to the sums of the first one.
      auto const pixels = [&](auto n, int64_t x) {
        constexpr int N = decltype(n)::value;
        auto const v0 = load<N>(c[0] + x), v1 = load<N>(c[1] + x), v2 = load<N>(c[2] + x);
        store<N>(luma + x, Lanes<F, N>(dot3(p.m, v0, v1, v2)));
        for (int k = 0; k < 2; ++k) {
          F* const sums = scratch.data + k * width + x;
          Lanes<F, N> const sum = dot3(p.m + 3 + 3 * k, v0, v1, v2);
          store<N>(sums, r == 0 ? sum : Lanes<F, N>(load<N>(sums) + sum));
        }
      };
      int64_t x = 0;
      for (; x + kLanes<T> <= width; x += kLanes<T>) pixels(Width<kLanes<T>>{}, x);
      for (; x < width; ++x) pixels(Width<1>{}, x);
    }
    for (int k = 0; k < 2; ++k) {
      F const* const sums = scratch.data + k * width;
      T* const to = p.chroma.row(2 * b + k, y);
      for (int64_t x = 0; x < width; x += 2) store<1>(to + x / 2, sums[x] + sums[x + 1]);
    }
  }
}

template <class T>
void join_chroma(JoinChroma<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.colors.width, height = p.chroma.height;
  Scratch<F> scratch(2 * width);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const b = i / height, y = i % height;
    for (int k = 0; k < 2; ++k) {
      T const* const from = p.chroma.row(2 * b + k, y);
      F* const both = scratch.data + k * width;
      for (int64_t x = 0; x < width; x += 2) both[x] = both[x + 1] = load<1>(from + x / 2);
    }
    for (int r = 0; r < p.rows; ++r) {
      T const* const luma = p.luma.row(b, y * p.rows + r);
      T* c[3];
      for (int k = 0; k < 3; ++k) c[k] = p.colors.row(3 * b + k, y * p.rows + r);
      for_each_vector<T>(0, width, [&](auto n, int64_t x) {
        constexpr int N = decltype(n)::value;
        Lanes<F, N> const v = load<N>(luma + x), u0 = load<N>(scratch.data + x), u1 = load<N>(scratch.data + width + x);
        for (int k = 0; k < 3; ++k) store<N>(c[k] + x, Lanes<F, N>(dot3(p.m + 3 * k, v, u0, u1)));
      });
    }
  }
}

KV_INSTANTIATE(split_chroma, SplitChroma)
KV_INSTANTIATE(join_chroma, JoinChroma)

}  // namespace kv::color::KV_ISA
