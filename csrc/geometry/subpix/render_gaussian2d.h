// Heat maps of Gaussians, each of which sums to 1, and the gradients to their means and standard deviations. A map is
// the product of a softmax along x and one along y. For a pixel at coordinate X, with d = (X - mean) / std:
//
//   w = exp(-(d^2 - d0^2) / 2) / sum of these         d0: d of the nearest pixel, whose weight is largest
//   dw / dmean = w (u - mean of u) / std              u = d - d0
//   dw / dstd = w (q - mean of q) / std               q = d^2 - d0^2 = u (u + 2 d0)
//
// Means of u and q are weighted by w.
#pragma once

#include "core/isa.h"
#include "geometry/subpix/spatial_expectation.h"

namespace kv::geometry {

template <class T>
struct RenderGaussian2d {
  using F = Compute<T>;
  T const *mean, *std;                  // (planes, 2), x before y
  int64_t mean_stride, std_stride;      // 0 if all maps share one
  int64_t planes, height, width, rows;  // rows of a chunk
  CoordAxis<F> along_x, along_y;
  T* maps;  // (planes, height, width)
  // For the gradient only:
  T const* grad;
  F* partial;               // (planes, chunks, 4): gradients to the mean, x before y, then to the standard deviation
  T *grad_mean, *grad_std;  // (planes, 2), set by the CUDA kernel; on the CPU the operator sums them

  KV_HD int64_t chunks() const { return (height + rows - 1) / rows; }
};

KV_KERNEL(render_gaussian2d, RenderGaussian2d)
KV_KERNEL(render_gaussian2d_backward, RenderGaussian2d)

// Sums of w, w u and w q over an axis.
template <class F>
struct GaussianSums {
  F all, u, q;
};

template <class F>
struct GaussianAxis {
  F nearest, gradient, start, inverse;  // nearest pixel, step of u between pixels, d0, 1 / std
  F normalizer, mean_u, mean_q;         // 1 / sum of w; weighted means of u and q

  KV_HD GaussianAxis(CoordAxis<F> const& coords, int64_t size, F mean, F std)
      : inverse(1 / std), normalizer(0), mean_u(0), mean_q(0) {
    F const at = coords.step > 0 ? (mean - coords.first) / coords.step : F(0), last = F(size - 1);
    nearest = at > 0 ? (at < last ? F(int64_t(at + F(.5))) : last) : F(0);
    gradient = coords.step * inverse;
    start = (coords.at(nearest) - mean) * inverse;
  }
  KV_HD void take(GaussianSums<F> const& sums) {
    normalizer = 1 / sums.all, mean_u = sums.u * normalizer, mean_q = sums.q * normalizer;
  }
  template <class V>
  KV_HD V u(V pixel) const {
    return (pixel - nearest) * gradient;
  }
  template <class V>
  KV_HD V q(V u) const {
    return u * (u + 2 * start);
  }
};

// `read` converts an element to a number.
template <class T, class Read>
KV_HD GaussianAxis<Compute<T>> gaussian_axis(RenderGaussian2d<T> const& p, int64_t plane, int which, Read read) {
  Compute<T> const mean = read(p.mean[plane * p.mean_stride + which]), std = read(p.std[plane * p.std_stride + which]);
  return which == 0 ? GaussianAxis<Compute<T>>(p.along_x, p.width, mean, std)
                    : GaussianAxis<Compute<T>>(p.along_y, p.height, mean, std);
}

}  // namespace kv::geometry
