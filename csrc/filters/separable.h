// Filtering with the product of a column ky and a row kx of weights, and what is made of it:
//
//   y(r, c) = alpha * sum over i, j of ky[i] kx[j] x(r - before_y + i, c - before_x + j) + beta * x(r, c)
//
// filter2d_separable takes the weights from memory, gaussian_blur2d from its sigma, and unsharp_mask is a Gaussian with
// alpha = -1, beta = 2. Included by separable_*.cpp, separable*.cu and the three *_op.cpp.
//
// The transpose is of the same form. Let w be the weights of one axis of n pixels and `full` the filter with w reversed
// over a gradient that is 0 outside, taken at every position the forward pass may read, -front ... n - 1 + back. Then
// the gradient of pixel j is the sum of `full` over the positions at which j stands: `full` is folded at the border.
//
//   constant   full(j)
//   circular   full(j) of the gradient continued circularly
//   replicate  full(j), at the rim also all of `full` outside
//   reflect    full(j) + full(-j) + full(2 (n - 1) - j)
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"

namespace kv {

// The weights along one axis.
template <class F>
struct Taps {
  F const* data;   // those of sample b at data + b * stride, or null when all are 1; of a Gaussian its sigma, or null
                   // when `sigma` serves all
  int64_t stride;  // 0 when one serves all samples
  F sigma;
  int size;
  int before;  // how many pixels before the one computed the first weight lies
  bool gaussian;
  bool reversed;

  KV_HD int front() const { return size - 1 - before; }  // what the pass this one transposes reads before the image
  KV_HD int back() const { return before; }
};

KV_HD float exp(float x) { return __builtin_expf(x); }
KV_HD double exp(double x) { return __builtin_exp(x); }

// Weight t of a sample; those of a Gaussian are still to be divided by their sum. A sigma that is not positive gives
// NaN.
template <class F>
KV_HD F tap(Taps<F> const& taps, int64_t sample, int t) {
  F const* const data = taps.data + sample * taps.stride;
  if (!taps.gaussian) return taps.data ? data[taps.reversed ? taps.size - 1 - t : t] : F(1);
  F const sigma = taps.data ? *data : taps.sigma;
  if (!(sigma > 0)) return F(__builtin_nanf(""));
  F const d = F(t) - F(taps.size - 1) / 2, nearest = F(taps.size % 2 ? 0 : 0.5);
  F const excess = d * d - nearest * nearest;  // the nearest pixel weighs 1, whatever underflows
  return excess == 0 ? F(1) : exp(-excess / (2 * sigma * sigma));
}

constexpr int kMostTaps = 701;  // of the CUDA kernel below, by the rows that shared memory holds

template <class T>
struct Separable {
  Planes<T const> x;
  Planes<T> y;
  Taps<Compute<T>> kx, ky;
  int64_t planes;  // of a sample
  Compute<T> alpha, beta;
  Border border;  // of x
  Border fold;    // how the result is folded, for the transposes of replicate and reflect; constant: it is not
};

constexpr int kWeightsTileWidth = 128;  // of the CUDA kernel below

// The gradient to the weights, from the gradient g to the output. With h = x filtered along rows, v along columns,
//
//   dkx[j] = sum over r, c of g(r, c) v(r, c - before_x + j)      dky[i] = sum over r, c of g(r, c) h(r - before_y + i,
//   c)
//
// Images are planar. Planes are cut into tiles; each writes its sums, kx before ky, to its row of `sums` (samples,
// tiles, kx + ky).
template <class T>
struct SeparableWeights {
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
KV_KERNEL(separable_weights, SeparableWeights)

}  // namespace kv
