// Separable filters: a column ky times a row kx of weights,
//
//   y(r, c) = alpha * sum over i, j of ky[i] kx[j] x(r - before_y + i, c - before_x + j) + beta * x(r, c)
//
// filter2d_separable takes the weights from memory, gaussian_blur2d computes them from sigma, and unsharp_mask is a
// Gaussian with alpha = -1, beta = 2.
//
// The transpose has the same form. Let w be the weights along one axis of n pixels. Let `full` be the filter with w
// reversed, over a gradient that is 0 out of bounds, at all positions that the forward pass reads, -front ... n - 1 +
// back. The gradient of pixel j is the sum of `full` over the positions whose border pixel is j: the border is
// accumulated.
//
//   constant   full(j)
//   circular   full(j) of the gradient continued circularly
//   replicate  full(j), for the first and the last pixel also all of `full` out of bounds
//   reflect    full(j) + full(-j) + full(2 (n - 1) - j)
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/stencils/filter_list.h"
#include "core/view.h"

namespace kv::filters {

// The weights along one axis.
template <class F>
struct Taps {
  F const* data;   // those of sample b at data + b * stride, or null when all are 1; of a Gaussian its sigma, or null
                   // when `sigma` serves all
  int64_t stride;  // 0 when one serves all samples
  F sigma;
  int size;
  int before;  // pixels from the first weight to the pixel that is computed
  bool gaussian;
  bool reversed;

  KV_HD void select(int64_t sample) {
    if (data) data += sample * stride;
  }
  // How many pixels before and after the image the pass reads whose transpose this is.
  KV_HD int front() const { return size - 1 - before; }
  KV_HD int back() const { return before; }
};

KV_HD float exp(float x) { return __builtin_expf(x); }
KV_HD double exp(double x) { return __builtin_exp(x); }

// Weight t of a sample. Those of a Gaussian must still be divided by their sum. A sigma that is not positive gives NaN.
template <class F>
KV_HD F tap_weight(Taps<F> const& taps, int64_t sample, int t) {
  F const* const data = taps.data + sample * taps.stride;
  if (!taps.gaussian) return taps.data ? data[taps.reversed ? taps.size - 1 - t : t] : F(1);
  F const sigma = taps.data ? *data : taps.sigma;
  if (!(sigma > 0)) return F(__builtin_nanf(""));
  F const d = F(t) - F(taps.size - 1) / 2, nearest = F(taps.size % 2 ? 0 : 0.5);
  F const excess = d * d - nearest * nearest;  // the nearest pixel weighs 1, whatever underflows
  return excess == 0 ? F(1) : exp(-excess / (2 * sigma * sigma));
}

// sum / divisor. Bytes are divided exactly: a product with the rounded reciprocal may miss a tie. On CUDA a fused
// product finds the error of that product, which takes a third of the instructions of a division.
template <class T, class V, class F>
KV_HD V quotient(V sum, F divisor, F reciprocal) {
  V const product = sum * reciprocal;
  if constexpr (sizeof(T) > 1) return product;
#if defined(__CUDA_ARCH__)
  return fmaf(fmaf(-product, divisor, sum), reciprocal, product);
#else
  return sum / divisor;
#endif
}

constexpr int kMaxTaps = 701;  // of the CUDA kernels: shared memory holds that many rows

// A Gaussian along an axis of the images of a list. With `follows` sigma and radius are those of a side of 1.
struct SideGaussian {
  double sigma, radius = -1;  // of the window; -1: three sigmas
  int least = 0;              // radius
  bool follows = true;
  double factor = 0;  // of values: SideBlur::factor

  template <class F>
  KV_HD void set(Taps<F>& taps, int64_t side) const {
    double const n = follows ? double(side) : 1., own = sigma * n;
    taps.sigma = F(own);
    taps.before = radius < 0 ? int(3 * own + 0.5) : max(int(__builtin_rint(radius * n)), least);
    taps.size = 2 * taps.before + 1;
  }
  // The same for a side.
  void fix(int64_t side) {
    Taps<double> taps{};
    set(taps, side);
    sigma = taps.sigma, radius = taps.before, follows = false;
  }
};

// A blur of a list whose windows, and with `scales` factors of even and of odd planes, follow the sides of an image.
struct SideBlur {
  SideGaussian x, y;
  bool is_used = false, scales = false;
  double less = 0, unit = 0;

  // Half a side, less `less` pixels, times axis.factor, and, if `unit` is not 0, times the root of so many heights and
  // widths.
  KV_HD double factor(SideGaussian const& axis, int64_t side, int64_t height, int64_t width) const {
    double const own = axis.factor * (double(side) - less) / 2;
    return unit == 0 ? own : own * __builtin_sqrt(double(height) * unit * (double(width) * unit));
  }
};

template <class T>
struct Separable {
  Planes<T const> x;
  Planes<T> y;
  Taps<Compute<T>> kx, ky;
  int64_t planes;  // of a sample
  Compute<T> alpha, beta;
  Border border;           // of x
  Border accumulation;     // of the border, into the result, by transposes: replicate, reflect, or constant for none
  SideBlur by_sides = {};  // of lists; the windows of `kx` and `ky` are the largest then
  Compute<T> alpha_of_odd = 0;  // planes, on CUDA, if it scales

  KV_HD void select(int64_t sample) { kx.select(sample), ky.select(sample); }
  KV_HD void fit_windows() {
    if (!by_sides.is_used) return;
    by_sides.x.set(kx, y.width), by_sides.y.set(ky, y.height);
    if (!by_sides.scales) return;
    alpha = Compute<T>(by_sides.factor(by_sides.x, y.width, y.height, y.width));
    alpha_of_odd = Compute<T>(by_sides.factor(by_sides.y, y.height, y.height, y.width));
  }
  KV_HD Compute<T> alpha_of(int64_t plane) const { return by_sides.scales && plane % 2 ? alpha_of_odd : alpha; }
};

template <class T>
struct SeparableList : FilterList<Separable<T>, T> {};

constexpr int kWeightsTileWidth = 128;  // of separable_weights_backward on CUDA

// The gradient to the weights, from the gradient g to the output. With h = x filtered along rows, v along columns,
//
//   dkx[j] = sum over r, c of g(r, c) v(r, c - before_x + j)
//   dky[i] = sum over r, c of g(r, c) h(r - before_y + i, c)
//
// Images are planar. Each tile of a plane writes its sums, kx before ky, to its row of `sums`, which has shape
// (samples, tiles, kx + ky).
template <class T>
struct SeparableWeightsBackward {
  Planes<T const> grad, x;
  Taps<Compute<T>> kx, ky;
  int64_t planes;  // of a sample
  Border border;
  int64_t tile_height, tile_width;
  Compute<T>* sums;

  KV_HD int64_t down() const { return (grad.height + tile_height - 1) / tile_height; }
  KV_HD int64_t across() const { return (grad.width + tile_width - 1) / tile_width; }
  KV_HD int64_t tiles() const { return planes * down() * across(); }  // of a sample
};

KV_KERNEL(separable, Separable)
KV_KERNEL(separable_list, SeparableList)
KV_KERNEL(separable_weights_backward, SeparableWeightsBackward)

}  // namespace kv::filters
