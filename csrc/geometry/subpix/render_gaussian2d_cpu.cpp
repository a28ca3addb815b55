// Heat maps of Gaussians on the CPU: chunks [begin, end) of all planes, each a few rows. Works on as many columns at
// once as fit into the first-level cache with their weights. Compiled once per instruction set.
#include "core/lanes.h"
#include "geometry/subpix/render_gaussian2d.h"

namespace kv::geometry::KV_ISA {
namespace {

constexpr int64_t kColumns = 512;

template <class F, int N>
KV_HD Lanes<F, N> weight_of(Lanes<F, N> q) {
  return vexp2<F, N>(q * F(-.5 * 1.44269504088896340736));
}

// Calls f(width, first pixel, pixel indices) for [0, size), each pixel exactly once: q may be inf where w is 0.
template <class T, class Call>
KV_HD void for_each_pixel(int64_t size, Call f) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  F numbers[N];
  for (int i = 0; i < N; ++i) numbers[i] = F(i);
  Lanes<F, N> const counted = load<N>(numbers);
  int64_t i = 0;
  for (; i + N <= size; i += N) f(Width<N>{}, i, Lanes<F, N>(counted + F(i)));
  for (; i < size; ++i) f(Width<1>{}, i, F(i));
}

template <class T>
KV_HD GaussianAxis<Compute<T>> axis_of(RenderGaussian2d<T> const& p, int64_t plane, int which) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  GaussianAxis<F> axis = gaussian_axis(p, plane, which, [](T x) { return F(load<1>(&x)); });
  Lanes<F, N> lanes[3] = {};
  F sums[3] = {};
  for_each_pixel<T>(which == 0 ? p.width : p.height, [&](auto width, int64_t, auto pixel) KV_INLINE {
    using V = decltype(pixel);
    V const u = axis.u(pixel), q = axis.q(u), w = weight_of<F, decltype(width)::value>(q);
    V const terms[] = {w, w == 0 ? V{} : V(w * u), w == 0 ? V{} : V(w * q)};
    for (int k = 0; k < 3; ++k)
      if constexpr (decltype(width)::value == 1)
        sums[k] += terms[k];
      else
        lanes[k] += terms[k];
  });
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < N; ++i) sums[k] += lanes[k][i];
  axis.take({sums[0], sums[1], sums[2]});
  return axis;
}

}  // namespace

template <class T>
void render_gaussian2d(RenderGaussian2d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  F across[kColumns];
  for (int64_t i = begin; i < end; ++i) {
    int64_t const plane = i / p.chunks(), first = i % p.chunks() * p.rows, last = min(first + p.rows, p.height);
    auto const x = axis_of(p, plane, 0), y = axis_of(p, plane, 1);
    F const normalizer = x.normalizer * y.normalizer;
    for (int64_t column = 0; column < p.width; column += kColumns) {
      int64_t const columns = min(kColumns, p.width - column);
      for_each_pixel<T>(columns, [&](auto width, int64_t k, auto pixel) KV_INLINE {
        constexpr int M = decltype(width)::value;
        store<M>(across + k, weight_of<F, M>(x.q(x.u(Lanes<F, M>(pixel + F(column))))));
      });
      for (int64_t row = first; row < last; ++row) {
        F const down = normalizer * weight_of<F, 1>(y.q(y.u(F(row))));
        T* const to = p.maps + (plane * p.height + row) * p.width + column;
        for_each_vector<T>(0, columns, [&](auto width, int64_t k) KV_INLINE {
          constexpr int M = decltype(width)::value;
          store<M>(to + k, load<M>(across + k) * down);
        });
      }
    }
  }
}

template <class T>
void render_gaussian2d_backward(RenderGaussian2d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  F across[3][kColumns];  // w, w (u - mean of u), w (q - mean of q)
  for (int64_t i = begin; i < end; ++i) {
    int64_t const plane = i / p.chunks(), first = i % p.chunks() * p.rows, last = min(first + p.rows, p.height);
    auto const x = axis_of(p, plane, 0), y = axis_of(p, plane, 1);
    F sums[4] = {};
    for (int64_t column = 0; column < p.width; column += kColumns) {
      int64_t const columns = min(kColumns, p.width - column);
      for_each_pixel<T>(columns, [&](auto width, int64_t k, auto pixel) KV_INLINE {
        using V = decltype(pixel);
        constexpr int M = decltype(width)::value;
        V const u = x.u(V(pixel + F(column))), q = x.q(u), w = weight_of<F, M>(q);
        store<M>(across[0] + k, w);
        store<M>(across[1] + k, w == 0 ? V{} : V(w * (u - x.mean_u)));
        store<M>(across[2] + k, w == 0 ? V{} : V(w * (q - x.mean_q)));
      });
      for (int64_t row = first; row < last; ++row) {
        F const v = y.u(F(row)), r = y.q(v), down = weight_of<F, 1>(r);
        if (down == 0) continue;
        T const* const from = p.grad + (plane * p.height + row) * p.width + column;
        Lanes<F, N> lanes[3] = {};
        F all[3] = {};
        for_each_pixel<T>(columns, [&](auto width, int64_t k, auto) KV_INLINE {
          constexpr int M = decltype(width)::value;
          auto const g = load<M>(from + k);
          for (int n = 0; n < 3; ++n)
            if constexpr (M == 1)
              all[n] += g * across[n][k];
            else
              lanes[n] += g * load<M>(across[n] + k);
        });
        for (int n = 0; n < 3; ++n)
          for (int k = 0; k < N; ++k) all[n] += lanes[n][k];
        sums[0] += down * all[1], sums[1] += down * (v - y.mean_u) * all[0];
        sums[2] += down * all[2], sums[3] += down * (r - y.mean_q) * all[0];
      }
    }
    for (int k = 0; k < 4; ++k)
      p.partial[4 * i + k] = sums[k] * (k % 2 ? y.inverse : x.inverse) * x.normalizer * y.normalizer;
  }
}

KV_INSTANTIATE(render_gaussian2d, RenderGaussian2d)
KV_INSTANTIATE(render_gaussian2d_backward, RenderGaussian2d)

}  // namespace kv::geometry::KV_ISA
