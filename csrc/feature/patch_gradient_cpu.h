// Patches in working memory on the CPU: rows with a pixel of border on each side, and room for whole vectors of pixels.
// Included by *_cpu.cpp files.
#pragma once

#include "core/scratch.h"
#include "patch_gradient.h"

namespace kv::feature::KV_ISA {
namespace {

// The numbers in the vectors that hold n of them.
template <class F>
KV_HD int whole_vectors(int n) {
  return (n + kLanes<F> - 1) / kLanes<F> * kLanes<F>;
}

template <class F>
struct PaddedPatch {
  F* data;  // (n + 2) rows
  int n, stride;

  KV_HD PaddedPatch(F* data, int n) : data(data), n(n), stride(whole_vectors<F>(n) + 2) {}
  static KV_HD int64_t size(int n) { return int64_t(n + 2) * (whole_vectors<F>(n) + 2); }
  KV_HD F* row(int y) const { return data + int64_t(y + 1) * stride + 1; }
  // Vectors of the last pixels of a row read what is behind them.
  KV_HD void clear() const {
    for (int64_t i = 0; i < size(n); ++i) data[i] = 0;
  }

  // Extends the patch by its border pixels, times a sign along each axis.
  KV_HD void extend(F sign_x, F sign_y) const {
    for (int y = 0; y < n; ++y) row(y)[-1] = sign_x * row(y)[0], row(y)[n] = sign_x * row(y)[n - 1];
    for (int x = -1; x <= n; ++x) row(-1)[x] = sign_y * row(0)[x], row(n)[x] = sign_y * row(n - 1)[x];
  }
  template <class T>
  KV_HD void read(T const* from) const {
    for (int y = 0; y < n; ++y)
      for_each_vector<T>(0, n, [&](auto width, int64_t x) KV_INLINE {
        constexpr int N = decltype(width)::value;
        store<N>(row(y) + x, load<N>(from + int64_t(y) * n + x));
      });
    extend(1, 1);
  }
};

template <int N, class F>
KV_HD auto neighbors(PaddedPatch<F> const& p, int y, int64_t x) {
  return [&p, y, x](int dy, int dx) KV_INLINE { return load<N>(p.row(y + dy) + x + dx); };
}

// Calls f(width, x, gradient) over row y.
template <class T, class F, class Call>
KV_HD void for_each_gradient(PaddedPatch<F> const& p, int y, Stencil<F> stencil, Call f) {
  for_each_vector<T>(0, p.n, [&](auto width, int64_t x) KV_INLINE {
    constexpr int N = decltype(width)::value;
    f(width, x, patch_gradient(stencil, neighbors<N>(p, y, x)));
  });
}

// The votes of pixels, of which each has two bins: its magnitude is the sum of both.
template <class F>
struct VotesOfPixels {
  F *first, *earlier, *later;  // the first bin, the magnitudes of both

  // angular_vote of N pixels.
  template <int N>
  KV_HD void set(int64_t i, Polar<Lanes<F, N>> const& polar, int bins, F offset) const {
    using V = Lanes<F, N>;
    V position = polar.angle * (F(bins) / F(2 * kPi)) + offset;
    position = position < 0 ? V(position + F(bins)) : position;
    V const whole = vfloor(position), later_vote = polar.magnitude * (position - whole);
    store<N>(first + i, V(whole >= F(bins) ? V(whole - F(bins)) : whole));
    store<N>(earlier + i, V(polar.magnitude - later_vote));
    store<N>(later + i, later_vote);
  }
};

// Writes the gradient of a patch from u and v, which are overwritten out of bounds.
template <class T, class F>
KV_HD void write_patch_gradient(T* to, Stencil<F> stencil, PaddedPatch<F> const& u, PaddedPatch<F> const& v) {
  u.extend(-1, 1);
  v.extend(1, -1);
  for (int y = 0; y < u.n; ++y)
    for_each_vector<T>(0, u.n, [&](auto width, int64_t x) KV_INLINE {
      constexpr int N = decltype(width)::value;
      store<N>(to + int64_t(y) * u.n + x, patch_gradient_vjp(stencil, neighbors<N>(u, y, x), neighbors<N>(v, y, x)));
    });
}

}  // namespace
}  // namespace kv::feature::KV_ISA
