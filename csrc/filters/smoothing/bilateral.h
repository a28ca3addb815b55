// Bilateral blur: a pixel becomes the mean of its window with weights that fall with the distance in space and in
// color,
//
//   y[c,p] = sum_t w(p, p+t) x[c,p+t] / n(p)           n(p) = sum_t w(p, p+t)
//   w(p,q) = 2^(space(q-p) - color |g[p]-g[q]|^2)
//
// The guide g is x itself or, for the joint blur, another image; |.| is the sum of absolute differences over its
// channels (l1) or the Euclidean distance (l2).
//
// Gradients. With a[c,p] = grad[c,p] / n(p) and b(p) = sum_c a[c,p] y[c,p], the weight w(p,q) has the gradient
// sum_c a[c,p] x[c,q] - b(p). The weight depends on g only through the distance of p and q, so w(q,p) = w(p,q). A
// position q receives from every position p of its window
//
//   for x[c]:  w a[c,p]
//   for g[k]:  w (sum_c (a[c,p] x[c,q] + a[c,q] x[c,p]) - b(p) - b(q)) d(-color |g[p]-g[q]|^2) / d g[k,q]
//
// Out of bounds g and x are the pixels of the border and a = b = 0; with the circular border a and b repeat as well. A
// pixel sums over all positions whose border pixel it is. There are no atomics, and each weight is computed once.
#pragma once

#include "core/border.h"
#include "core/images.h"
#include "core/isa.h"

namespace kv::filters {

// The numbers are stable: exported graphs contain them.
enum class ColorDistance : int { l1 = 0, l2 = 1 };

// The rates at which weights fall: 2^(space_y dy^2 + space_x dx^2 - color d^2).
template <class F>
struct Falloff {
  F color, space_y, space_x;
};

// Standard deviations, as numbers or read on the device.
template <class F>
struct Sigmas {
  F color, y, x;
  F const *colors, *spaces;            // (B) or (1), and (B, 2) or (1, 2); or null
  int64_t color_stride, space_stride;  // 0 where one serves the batch

  KV_HD Falloff<F> at(int64_t b) const {
    F const* const space = spaces ? spaces + b * space_stride : nullptr;
    return {rate(colors ? colors[b * color_stride] : color), -rate(space ? space[0] : y), -rate(space ? space[1] : x)};
  }

 private:
  // 1 / (2 sigma^2 log 2), clamped to a finite number so that distance 0 has weight 1 for every sigma; NaN where sigma
  // is not positive.
  KV_HD static F rate(F sigma) {
    F const rate = F(0.72134752044448170368) / (sigma * sigma);
    return sigma > 0 ? min(rate, F(1e30)) : F(__builtin_nanf(""));
  }
};

// The guide of a joint blur has the compute type, like the sigmas.
template <class T>
struct Bilateral {
  Images<T const> x;
  Images<Compute<T> const> guide;
  Images<T> y;
  Images<T> totals;  // CUDA: n, from which the gradient takes less time; or of no channels
  Sigmas<Compute<T>> sigma;
  int ky, kx;
  Border border;
  bool l1, joint;
};

template <class T>
struct BilateralBackward {
  Images<T const> grad, x;
  Images<T const> y, totals;  // CUDA: those of the forward pass, or without data
  Images<Compute<T> const> guide;
  Images<T> grad_x, grad_guide;  // where x is its own guide, grad_x has both gradients
  Sigmas<Compute<T>> sigma;
  int ky, kx;
  Border border;
  bool l1, joint, needs_x, needs_guide;
};

// The gradients to the sigmas, except for the factor 1 / sigma^3, summed over each row of an image: the gradient of
// each weight times the squared distance in color, in y and in x.
template <class T>
struct BilateralSigmas {
  Images<T const> grad, x;
  Images<Compute<T> const> guide;
  T* sums;  // (B, 3, H)
  Sigmas<Compute<T>> sigma;
  int ky, kx;
  Border border;
  bool l1, joint;
};

KV_KERNEL(bilateral_blur, Bilateral)
KV_KERNEL(bilateral_blur_backward, BilateralBackward)
KV_KERNEL(bilateral_blur_sigma_sums, BilateralSigmas)

}  // namespace kv::filters
