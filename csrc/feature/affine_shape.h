// Second moments of the gradients of square patches, normalized: (a, b, c) over the larger of a and c, where
//
//   a = mean (w gx)^2     b = mean w^2 gx gy     c = mean (w gy)^2     Sobel; w: Gaussian of sigma n / sqrt 2 and sum 1
//
// If two of |a|, |b|, |c| are at most eps, the patch is flat or has one direction along an axis; it gives the circle
// (1, 0, 1), which does not depend on the patch.
#pragma once

#include "core/isa.h"
#include "patch_gradient.h"

namespace kv::feature {

template <class T>
struct AffineShape {
  T const* patches;  // (count, n, n)
  T* shapes;         // (count, 3)
  int64_t count;
  int n;
  Compute<T> eps;
  Compute<T> scale;  // of the squared Gaussian, and 1 / n^2
};

template <class T>
struct AffineShapeBackward {
  T const* grad;
  T const* patches;
  T* grad_patches;
  int64_t count;
  int n;
  Compute<T> eps, scale;
};

KV_KERNEL(affine_shape, AffineShape)
KV_KERNEL(affine_shape_backward, AffineShapeBackward)

template <class F>
KV_HD F shape_weight(int i, int n) {  // squared, along an axis
  F const g = centered_gaussian(i, n, F(n) * F(0.70710678118654752440));
  return g * g;
}

// The sums over pixels become a normalized shape. NaN is kept.
template <class F>
KV_HD bool is_circle(F const (&m)[3], F eps) {
  int small = 0;
  for (int i = 0; i < 3; ++i) small += (m[i] < 0 ? -m[i] : m[i]) <= eps;
  return small >= 2;
}
template <class F>
KV_HD void to_shape(F (&m)[3], F eps) {
  if (is_circle(m, eps)) {
    m[0] = 1, m[1] = 0, m[2] = 1;
    return;
  }
  F const largest = max(m[0], m[2]);
  for (int i = 0; i < 3; ++i) m[i] = m[i] / largest;
}
// From the gradients g to the shape of sums m to those of the sums.
template <class F>
KV_HD void to_shape_vjp(F const (&m)[3], F eps, F (&g)[3]) {
  if (is_circle(m, eps)) {
    g[0] = g[1] = g[2] = 0;
    return;
  }
  int const at = m[0] < m[2] ? 2 : 0;
  F const largest = m[at], along = (g[0] * m[0] + g[1] * m[1] + g[2] * m[2]) / largest;
  for (int i = 0; i < 3; ++i) g[i] = (i == at ? g[i] - along : g[i]) / largest;
}

}  // namespace kv::feature
