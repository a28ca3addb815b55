// The photometric error on CUDA. A block sums over a tile of the target; then one block per sample adds up the tiles.
#include "geometry/transform/photometric.h"
#include "geometry/transform/sampling.cuh"

namespace kv::geometry::cuda {
namespace {

// Calls pixel(y, x, window, coordinates) for the thread's pixels whose sampling coordinates lie between four pixels.
template <class T, class Pixel>
__device__ __forceinline__ void for_each_in_bounds(Photometric<T> const& p, TileCoords<Compute<T>> const& coords,
                                                   Pixel pixel) {
  using F = Compute<T>;
  int const x = coords.tile.x + column_in_tile();
#pragma unroll 1
  for (int y = coords.tile.y + row_in_tile();
       x < p.target.width && y < min(coords.tile.y + kTile, int(p.target.height)); y += kRowStep) {
    F u, v;
    coords.at(y, x, u, v);
    TapWindow<2, F> const window(p, u, v);
    if (window.inside) pixel(y, x, window, u, v);
  }
}

// Calls channel(residual, derivatives along both axes).
template <class T, class F, class Channel>
__device__ __forceinline__ void for_each_channel(Photometric<T> const& p, int64_t b, int y, int x,
                                                 TapWindow<2, F> const& window, Channel channel) {
  int64_t const row = p.source.row_stride, step = p.source.step;
  F wx[2], wy[2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  T const* from = p.source.row(b, 0, window.y) + window.x * step;
  T const* target = p.target.row(b, 0, y) + x * p.target.step;
#pragma unroll 3
  for (int c = 0; c < p.source.channels; ++c) {
    F const a00 = read(from[0]), a01 = read(from[step]), a10 = read(from[row]), a11 = read(from[row + step]);
    F const value = (a00 * wx[0] + a01 * wx[1]) * wy[0] + (a10 * wx[0] + a11 * wx[1]) * wy[1];
    channel(value - F(read(*target)), (a01 - a00) * wy[0] + (a11 - a10) * wy[1],
            (a10 - a00) * wx[0] + (a11 - a01) * wx[1]);
    from += p.source.channel_stride;
    target += p.target.channel_stride;
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) photometric_tiles(Photometric<T> p, TileGrid tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  if (threadIdx.x == 0) tile.init(tiles, p.coords);
  __syncthreads();
  TileCoords<F> const coords(p.coords, tile);
  F sums[kPhotometricSums] = {};
  for_each_in_bounds(p, coords, [&](int y, int x, TapWindow<2, F> const& window, F u, F v) {
    F grad_u = 0, grad_v = 0;
    for_each_channel(p, coords.tile.b, y, x, window, [&](F r, F along_x, F along_y) {
      F derivative;
      sums[9] += distance_of(p.distance, r, p.eps, derivative);
      grad_u += derivative * along_x;
      grad_v += derivative * along_y;
    });
    F const scale = reciprocal(coords.weight(y, x));
    F const g[] = {grad_u * scale, grad_v * scale, -(grad_u * u + grad_v * v) * scale};
#pragma unroll
    for (int i = 0; i < 3; ++i) {
      sums[3 * i] += g[i] * F(x);
      sums[3 * i + 1] += g[i] * F(y);
      sums[3 * i + 2] += g[i];
    }
    sums[10] += 1;
  });
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * kPhotometricSums);
}

template <class F>
__global__ void __launch_bounds__(kThreads) normal_tiles(PhotometricNormalEquations<F> p, TileGrid tiles) {
  __shared__ Tile<F> tile;
  if (threadIdx.x == 0) tile.init(tiles, p.coords);
  __syncthreads();
  TileCoords<F> const coords(p.coords, tile);
  F const* const last_line = p.coords.matrices + coords.tile.b * p.coords.matrix_stride + 6;
  F sums[kNormalSums] = {};
  for_each_in_bounds(p, coords, [&](int row, int column, TapWindow<2, F> const& window, F to_x, F to_y) {
    F xx = 0, xy = 0, yy = 0, by_x = 0, by_y = 0;
    for_each_channel(p, coords.tile.b, row, column, window, [&](F r, F along_x, F along_y) {
      F derivative;
      sums[45] += distance_of(p.distance, r, p.eps, derivative);
      F const weight = weight_of(p.distance, r, p.eps), wx = weight * along_x, wy = weight * along_y;
      xx += wx * along_x;
      xy += wx * along_y;
      yy += wy * along_y;
      by_x += wx * r;
      by_y += wy * r;
    });
    F const x = F(column) * p.x_scale + p.x_offset, y = F(row) * p.y_scale + p.y_offset;
    F const u = to_x * p.u_scale + p.u_offset, v = to_y * p.v_scale + p.v_offset;
    F line[6], gradient[3];
    to_lines(xx / (p.u_scale * p.u_scale), xy / (p.u_scale * p.v_scale), yy / (p.v_scale * p.v_scale), by_x / p.u_scale,
             by_y / p.v_scale, u, v, x * last_line[0] + (y * last_line[1] + last_line[2]), line, gradient);
    F const products[] = {x * x, x * y, x, y * y, y, F(1)};
#pragma unroll
    for (int k = 0; k < 6; ++k)
#pragma unroll
      for (int i = 0; i < 6; ++i) sums[6 * k + i] += line[k] * products[i];
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      sums[36 + 3 * k] += gradient[k] * x;
      sums[36 + 3 * k + 1] += gradient[k] * y;
      sums[36 + 3 * k + 2] += gradient[k];
    }
    sums[46] += 1;
  });
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * kNormalSums);
}

// Calls take(sample, N sums) from one thread of a block.
template <int N, class Take>
__device__ __forceinline__ void add_parts(double const* all, int64_t parts, Take take) {
  __shared__ double total[N];
  int64_t const b = blockIdx.x;
  double sums[N] = {};
  for (int64_t part = threadIdx.x; part < parts; part += kThreads)
    for (int i = 0; i < N; ++i) sums[i] += all[(b * parts + part) * N + i];
  store_block_sums<kThreads>(sums, total);
  __syncthreads();
  if (threadIdx.x == 0) take(b, total);
}

template <class T>
__global__ void photometric_samples(PhotometricTotal<T> p) {
  add_parts<kPhotometricSums>(p.sums, p.parts, [&](int64_t b, double* sums) { photometric_total_of(p, b, sums); });
}

template <class T>
__global__ void normal_samples(PhotometricNormalTotal<T> p) {
  add_parts<kNormalSums>(p.sums, p.parts, [&](int64_t b, double* sums) { photometric_normal_total_of(p, b, sums); });
}

}  // namespace

template <class T>
int photometric(Photometric<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.target.batch, p.target.height, p.target.width, 1);
  photometric_tiles<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int photometric_total(PhotometricTotal<T> const& p, CUstream_st* stream) {
  photometric_samples<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int photometric_normal_equations(PhotometricNormalEquations<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.target.batch, p.target.height, p.target.width, 1);
  normal_tiles<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int photometric_normal_total(PhotometricNormalTotal<T> const& p, CUstream_st* stream) {
  normal_samples<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(photometric, Photometric)
KV_INSTANTIATE_COMPUTED(photometric_normal_equations, PhotometricNormalEquations)
KV_INSTANTIATE_COMPUTED(photometric_normal_total, PhotometricNormalTotal)
KV_INSTANTIATE_COMPUTED(photometric_total, PhotometricTotal)

}  // namespace kv::geometry::cuda
