// The photometric distance of views by depth on CUDA: one thread for each pixel of the target, which loops over the
// views.
#include "geometry/depth/photometric.h"
#include "geometry/depth/warp.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads)
    photometric_tiles(__grid_constant__ PhotometricDepth<T> const p, DepthTiles tiles) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  tiles.locate(b, y, x);
  bool const in_bounds = x < p.target.width && y < p.target.height;
  int64_t const row = p.x.row_stride, step = p.x.step;
  F grad_depth = 0;
#pragma unroll 1
  for (int i = 0; i < p.views; ++i) {
    F sums[kProjectionSums] = {};
    if (in_bounds) {
      Reprojection<F> const projection(p.projections + b * p.projection_stride + i * p.projection_view_stride);
      DepthCoords<T> const coords(p, projection, b, y, x);
      TapWindow<2, F> const window(p, coords.u, coords.v);
      if (window.inside) {
        F wx[2], wy[2], grad_u = 0, grad_v = 0;
        tap_weights(window.tx, wx);
        tap_weights(window.ty, wy);
        T const* from = p.x.row(b, 0, window.y) + i * p.view_stride + window.x * step;
        T const* target = p.target.row(b, 0, y) + x * p.target.step;
#pragma unroll 3
        for (int c = 0; c < p.x.channels; ++c) {
          F const a00 = read(from[0]), a01 = read(from[step]), a10 = read(from[row]), a11 = read(from[row + step]);
          F const value = (a00 * wx[0] + a01 * wx[1]) * wy[0] + (a10 * wx[0] + a11 * wx[1]) * wy[1];
          F derivative;
          sums[12] += distance_of(p.distance, value - F(read(*target)), p.eps, derivative);
          grad_u += derivative * ((a01 - a00) * wy[0] + (a11 - a10) * wy[1]);
          grad_v += derivative * ((a10 - a00) * wx[0] + (a11 - a01) * wx[1]);
          from += p.x.channel_stride;
          target += p.target.channel_stride;
        }
        sums[13] = 1;
        F g[3];
        grad_depth += projection.vjp(coords.x, coords.y, coords.u, coords.v, coords.scale, grad_u, grad_v, g);
        add_to_projection(g, coords.x, coords.y, coords.d, sums);
      }
    }
    store_block_sums<kThreads>(sums, p.sums + (int64_t(blockIdx.x) * p.views + i) * kProjectionSums);
  }
  if (in_bounds) p.grad_depth[(b * p.target.height + y) * p.target.width + x] = grad_depth;
}

}  // namespace

template <class T>
int photometric_depth(PhotometricDepth<T> const& p, CUstream_st* stream) {
  DepthTiles const tiles(p.target.batch, p.target.height, p.target.width);
  photometric_tiles<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE(photometric_depth, PhotometricDepth)

}  // namespace kv::geometry::cuda
