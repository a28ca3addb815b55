// Affine shapes of patches [begin, end) on the CPU. Compiled once per instruction set.
#include "affine_shape.h"
#include "patch_gradient_cpu.h"

namespace kv::feature::KV_ISA {
namespace {

template <class T>
KV_HD void fill_weights(Compute<T>* weights, int n) {
  for (int i = 0; i < n; ++i) weights[i] = shape_weight<Compute<T>>(i, n);
}

// The sums of a patch, row by row.
template <class T, class F>
KV_HD void sum_moments(PaddedPatch<F> const& patch, F const* weights, F scale, F (&m)[3]) {
  constexpr int N = kLanes<T>;
  m[0] = m[1] = m[2] = 0;
  for (int y = 0; y < patch.n; ++y) {
    F row[3] = {};
    auto const add = [&](auto width, int64_t x, Lanes<F, N>(&sums)[3]) KV_INLINE {
      constexpr int W = decltype(width)::value;
      auto const g = patch_gradient(sobel_stencil<F>(), neighbors<W>(patch, y, x));
      auto const w = load<W>(weights + x);
      if constexpr (W == 1)
        row[0] += w * g.x * g.x, row[1] += w * g.x * g.y, row[2] += w * g.y * g.y;
      else
        sums[0] += w * g.x * g.x, sums[1] += w * g.x * g.y, sums[2] += w * g.y * g.y;
    };
    Lanes<F, N> sums[3] = {};
    int x = 0;
    for (; x + N <= patch.n; x += N) add(Width<N>{}, x, sums);
    for (; x < patch.n; ++x) add(Width<1>{}, x, sums);
    for (int i = 0; i < 3; ++i) {
      for (int lane = 0; lane < N; ++lane) row[i] += sums[i][lane];
      m[i] += row[i] * weights[y] * scale;
    }
  }
}

}  // namespace

template <class T>
void affine_shape(AffineShape<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Scratch<F> scratch(p.n + PaddedPatch<F>::size(p.n));
  F* const weights = scratch.data;
  PaddedPatch<F> const patch(weights + p.n, p.n);
  fill_weights<T>(weights, p.n);
  for (int64_t k = begin; k < end; ++k) {
    patch.read(p.patches + k * p.n * p.n);
    F m[3];
    sum_moments<T>(patch, weights, p.scale, m);
    to_shape(m, p.eps);
    for (int i = 0; i < 3; ++i) store<1>(p.shapes + 3 * k + i, m[i]);
  }
}

template <class T>
void affine_shape_backward(AffineShapeBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int const n = p.n;
  int64_t const padded = PaddedPatch<F>::size(n);
  Scratch<F> scratch(n + 3 * padded);
  F* const weights = scratch.data;
  PaddedPatch<F> const patch(weights + n, n), u(patch.data + padded, n), v(u.data + padded, n);
  fill_weights<T>(weights, n);
  for (int64_t k = begin; k < end; ++k) {
    patch.read(p.patches + k * n * n);
    F m[3], g[3];
    sum_moments<T>(patch, weights, p.scale, m);
    for (int i = 0; i < 3; ++i) g[i] = load<1>(p.grad + 3 * k + i);
    to_shape_vjp(m, p.eps, g);
    for (int y = 0; y < n; ++y)
      for_each_gradient<T>(patch, y, sobel_stencil<F>(), [&](auto width, int64_t x, auto gradient) KV_INLINE {
        constexpr int N = decltype(width)::value;
        auto const w = load<N>(weights + x) * (weights[y] * p.scale);
        store<N>(u.row(y) + x, w * (gradient.x * (2 * g[0]) + gradient.y * g[1]));
        store<N>(v.row(y) + x, w * (gradient.y * (2 * g[2]) + gradient.x * g[1]));
      });
    write_patch_gradient(p.grad_patches + k * n * n, sobel_stencil<F>(), u, v);
  }
}

KV_INSTANTIATE(affine_shape, AffineShape)
KV_INSTANTIATE(affine_shape_backward, AffineShapeBackward)

}  // namespace kv::feature::KV_ISA
