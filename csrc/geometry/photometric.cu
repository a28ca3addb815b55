// The photometric distance on CUDA: a block a tile of the target, then one block a sample adds the tiles up.
#include "photometric.h"
#include "sample.cuh"

namespace kv::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads) photometric_tiles(Photometric<T> p, Tiles tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  if (threadIdx.x == 0) tile.open(tiles, p.places, p.places.use);
  __syncthreads();
  PlacesOf<F> const places(p.places, tile);
  int64_t const b = tile.b;
  int const x = tile.x + column_in_tile();
  int64_t const row = p.source.row_stride, step = p.source.step;
  F sums[kPhotometricSums] = {};
#pragma unroll 1
  for (int y = tile.y + row_in_tile(); x < p.target.width && y < min(tile.y + kTile, int(p.target.height));
       y += kRunRows) {
    F u, v;
    places.at(y, x, u, v);
    Window<2, F> const window(p, u, v);
    if (!window.inside) continue;
    F wx[2], wy[2], to_u = 0, to_v = 0;
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    T const* from = p.source.row(b, 0, window.y) + window.x * step;
    T const* target = p.target.row(b, 0, y) + x * p.target.step;
#pragma unroll 3
    for (int c = 0; c < p.source.channels; ++c) {
      F const a00 = read(from[0]), a01 = read(from[step]), a10 = read(from[row]), a11 = read(from[row + step]);
      F const value = (a00 * wx[0] + a01 * wx[1]) * wy[0] + (a10 * wx[0] + a11 * wx[1]) * wy[1];
      F slope;
      sums[9] += distance_of(p.distance, value - F(read(*target)), p.eps, slope);
      to_u += slope * ((a01 - a00) * wy[0] + (a11 - a10) * wy[1]);
      to_v += slope * ((a10 - a00) * wx[0] + (a11 - a01) * wx[1]);
      from += p.source.channel_stride;
      target += p.target.channel_stride;
    }
    F const scale = reciprocal(places.weight(y, x));
    F const g[] = {to_u * scale, to_v * scale, -(to_u * u + to_v * v) * scale};
#pragma unroll
    for (int i = 0; i < 3; ++i) {
      sums[3 * i] += g[i] * F(x);
      sums[3 * i + 1] += g[i] * F(y);
      sums[3 * i + 2] += g[i];
    }
    sums[10] += 1;
  }
  add_block(sums, p.sums + int64_t(blockIdx.x) * kPhotometricSums);
}

template <class T>
__global__ void photometric_samples(PhotometricTotal<T> p) {
  __shared__ double total[kPhotometricSums];
  int64_t const b = blockIdx.x;
  double sums[kPhotometricSums] = {};
  for (int64_t part = threadIdx.x; part < p.parts; part += kThreads)
    for (int i = 0; i < kPhotometricSums; ++i) sums[i] += p.sums[(b * p.parts + part) * kPhotometricSums + i];
  add_block(sums, total);
  __syncthreads();
  if (threadIdx.x == 0) photometric_total_of(p, b, total);
}

}  // namespace

template <class T>
int photometric(Photometric<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.target.batch, p.target.height, p.target.width, 1);
  photometric_tiles<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int photometric_total(PhotometricTotal<T> const& p, CUstream_st* stream) {
  photometric_samples<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(photometric, Photometric)
KV_INSTANTIATE_COMPUTED(photometric_total, PhotometricTotal)

}  // namespace kv::cuda
