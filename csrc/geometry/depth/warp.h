// Warps by depth: the pixel (x, y) of the output, at depth d, is sampled from the source at
//
//   (u, v) = (U, V) / W, (U, V, W) = d A (x, y, 1) + b, projection = [A | b],
//
// where A = K' R K^-1 and b = K' t for cameras K and K' and the motion (R, t) between them. A point that is not in
// front of the source's camera, W > 0, is out of bounds and has no gradient. Interpolation is bilinear or nearest;
// padding modes are those of transform/sampling.h.
#pragma once

#include "geometry/transform/sampling.h"

namespace kv::geometry {

template <class F>
struct Reprojection {
  F m[12];

  KV_HD explicit Reprojection(F const* projection) {
    for (int i = 0; i < 12; ++i) m[i] = projection[i];
  }
  // A row of A times (x, y, 1).
  template <class V>
  KV_HD V ray(int row, V x, F y) const {
    return x * m[4 * row] + (y * m[4 * row + 1] + m[4 * row + 2]);
  }
  // Sets (u, v), NaN behind the camera. `scale` is 1 / W.
  template <class V>
  KV_HD void at(V x, F y, V d, V& u, V& v, V& scale) const {
    V const w = ray(2, x, y) * d + m[11];
    scale = w > 0 ? V(1 / w) : V(V{} + F(__builtin_nanf("")));
    u = (ray(0, x, y) * d + m[3]) * scale;
    v = (ray(1, x, y) * d + m[7]) * scale;
  }
  // Converts the gradient to (u, v) into that to (U, V, W), 0 if it is not finite, and returns the gradient to d.
  template <class V>
  KV_HD V vjp(V x, F y, V u, V v, V scale, V grad_u, V grad_v, V (&g)[3]) const {
    g[0] = grad_u * scale;
    g[1] = grad_v * scale;
    g[2] = -(grad_u * u + grad_v * v) * scale;
    V grad_d{};
    for (int k = 0; k < 3; ++k) {
      g[k] = g[k] - g[k] == 0 ? g[k] : V{};
      grad_d += g[k] * ray(k, x, y);
    }
    return grad_d - grad_d == 0 ? grad_d : V{};  // the projection may be NaN
  }
};

// An image, the depths of the output's pixels, and the projections that map these to sampling coordinates.
template <class T>
struct DepthSampling : Sampling<T> {
  Images<T const> x;
  Images<Compute<T> const> depth;  // one channel
  Compute<T> const* projections;
  int64_t projection_stride;  // 0 if the batch shares one

  KV_HD Reprojection<Compute<T>> projection(int64_t b) const {
    return Reprojection<Compute<T>>(projections + b * projection_stride);
  }
};

template <class T>
struct DepthWarp : DepthSampling<T> {
  Images<T> y;
};

// The gradients to depths and projections. The latter are 14 sums for each chunk; the last two are not used here.
template <class T>
struct DepthWarpCoordsBackward : DepthSampling<T> {
  Images<T const> grad;
  Compute<T>* grad_depth;  // (B, h, w)
  double* sums;            // (B, chunks, 14)
  int64_t parts;
};

// The gradient to the image.
template <class T>
struct DepthWarpImageBackward : DepthSampling<T> {
  Images<T const> grad;
  Images<T> grad_x;  // contiguous
};

constexpr int kProjectionSums = 14;  // twelve of the projection, the sum of distances, the number of pixels

// Adds the sums of chunks for samples and views: gradients to projections. With a loss these are divided by the number
// of terms, which is that of pixels times channels.
template <class T>
struct ProjectionTotal {
  double const* sums;  // (B, chunks, views, 14)
  int64_t parts, batch;
  int views, channels;
  T *grad, *loss, *inverse_terms;  // (B, views, 3, 4), (B), 1 / terms (B); loss and 1 / terms may be null
};

KV_KERNEL(depth_warp, DepthWarp)
KV_KERNEL(depth_warp_coords_backward, DepthWarpCoordsBackward)
KV_KERNEL(depth_warp_image_backward, DepthWarpImageBackward)
KV_KERNEL(projection_total, ProjectionTotal)

// The tile of a block on CUDA: 32 x 8 pixels.
constexpr int kDepthTileWidth = 32, kDepthTileHeight = 8;

}  // namespace kv::geometry
