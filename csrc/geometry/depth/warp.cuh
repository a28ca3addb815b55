// Sampling coordinates from depth on CUDA.
#pragma once

#include "geometry/depth/warp.h"
#include "geometry/transform/sampling.cuh"

namespace kv::geometry::cuda {

// The pixels of a block: 32 x 8, one warp for each row.
struct DepthTiles {
  unsigned across, down, count;
  DepthTiles(int64_t batch, int64_t height, int64_t width)
      : across(unsigned(ceil_div(width, kDepthTileWidth))),
        down(unsigned(ceil_div(height, kDepthTileHeight))),
        count(unsigned(batch * across * down)) {}
  // Sets the block's sample and the thread's pixel.
  __device__ __forceinline__ void locate(int64_t& b, int& y, int& x) const {
    unsigned const row = blockIdx.x / across;
    b = row / down;
    x = int(blockIdx.x - row * across) * kDepthTileWidth + threadIdx.x % 32;
    y = int(row - unsigned(b) * down) * kDepthTileHeight + threadIdx.x / 32;
  }
};

// A pixel's sampling coordinates (u, v) in a source, and the numbers that its gradients need.
template <class T>
struct DepthCoords {
  using F = Compute<T>;
  F x, y, d, u, v, scale;
  __device__ __forceinline__ DepthCoords(DepthSampling<T> const& p, Reprojection<F> const& projection, int64_t b, int y,
                                         int x)
      : x(F(x)), y(F(y)), d(p.depth.row(b, 0, y)[x * p.depth.step]) {
    projection.at(this->x, this->y, d, u, v, scale);
    d = d - d == 0 ? d : F(0);  // without finite depth (u, v) is not valid; d must then not make gradients NaN
  }
  __device__ __forceinline__ TapWindow<2, F> window(DepthSampling<T> const& p) const {
    bool const nearest = p.interpolation == Interpolation::nearest;
    return TapWindow<2, F>(p, nearest ? ::rint(u) : u, nearest ? ::rint(v) : v);
  }
};

// Adds the twelve products that a pixel contributes to the gradient of a projection.
template <class F>
__device__ __forceinline__ void add_to_projection(F const (&g)[3], F x, F y, F d, F* sums) {
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    F const by_d = g[k] * d;
    sums[4 * k] += by_d * x;
    sums[4 * k + 1] += by_d * y;
    sums[4 * k + 2] += by_d;
    sums[4 * k + 3] += g[k];
  }
}

}  // namespace kv::geometry::cuda
