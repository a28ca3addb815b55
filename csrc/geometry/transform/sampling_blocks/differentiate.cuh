// The gradients of sampling coordinates, and of the matrices they come from, by a block of threads.
#pragma once

#include "core/block_reduce.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

// The gradient of sampling coordinates, from their taps and the gradients of the output.
template <int K, class F>
struct CoordGrads {
  F wx[K], wy[K], dx[K], dy[K];
  F along_x = 0, along_y = 0;

  __device__ __forceinline__ void set(F tx, F ty) {
    tap_weights(tx, wx);
    tap_weights(ty, wy);
    tap_derivatives(tx, dx);
    tap_derivatives(ty, dy);
  }
  // Of values(j, i), with the gradient g.
  template <class Values>
  __device__ __forceinline__ void add(Values values, F g) {
    F x = 0, y = 0;
#pragma unroll
    for (int j = 0; j < K; ++j) {
      F line = 0, across = 0;
#pragma unroll
      for (int i = 0; i < K; ++i) {
        F const value = F(values(j, i));
        line += value * wx[i];
        across += value * dx[i];
      }
      x += across * wy[j];
      y += line * dy[j];
    }
    along_x += g * x;
    along_y += g * y;
  }
};

// How many blocks of threads a multiprocessor has at least.
template <class T, int K>
constexpr int kDifferentiateBlocks = K == 4 || sizeof(T) == 8 ? 2 : 4;

// Writes the sums of the block's tiles to a matrix, or the gradients of a map.
template <int K, bool Aligned, class T>
__device__ __forceinline__ void differentiate_block(SampleCoordsBackward<T> const& p, TileGrid const& tiles) {
  using F = Compute<T>;
  __shared__ BlockTiles<F> block;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.grad.width), height = int(p.grad.height);
  block.template prepare<K>(tiles, p, p.grad.batch, width, height);

  F sums[9] = {};
#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block) && block.tiles[number].x < width; ++number) {
    Tile<F> const& tile = block.tiles[number];
    TileCoords<F> const coords(p.coords, tile);
    void* const kept = shared_pixels + SourceTile<T, Aligned>::bytes(p.x.channels);
    block.template find_taps<K>(number, p, width, height, kept);
    SourceTile<T, Aligned> source_tile(shared_pixels, block.taps[number], p.x, p, F());
    int64_t const b = tile.b;
    int const x = tile.x + column_in_tile<T>();
    for_each_channel_group<SourceTile<T, Aligned>::kChannels>(p.x.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (source_tile.fits)
        source_tile.template load<N>(p.x, tile.image, first, p.x_axis, p.y_axis,
                                     [&](int c) { return p.fill ? round_to<T>(p.fill_value(b, c)) : T{}; });
      T const* const origin = source_tile.origin(tile.u, tile.v);
      ThreadCoords<F> const thread_coords(tile, p.coords, kept, column_in_tile<T>(), row_in_tile<T>());
#pragma unroll 1
      for (int run = 0; run < kPixelsPerThread; ++run) {
        int const y = tile.y + row_in_tile<T>() + run * kRowStep;
        if (x >= width || y >= height) break;
        T const* const grad = p.grad.row(b, first, y) + x * p.grad.step;
        F g[N];
#pragma unroll
        for (int k = 0; k < N; ++k) g[k] = F(read(grad[k * p.grad.channel_stride]));
        F u, v;
        CoordGrads<K, F> grads;
        if (source_tile.fits) {
          F tx, ty;
          thread_coords.at(run, u, v);
          int const column = near_tap<K>(u, tx), row = near_tap<K>(v, ty);
          grads.set(tx, ty);
          int const pitch = source_tile.pitch(), plane = source_tile.plane();
          T const* const taps = origin + (row * pitch + column);
#pragma unroll
          for (int k = 0; k < N; ++k)
            grads.add([&](int j, int i) { return read(taps[k * plane + j * pitch + i]); }, g[k]);
        } else {
          coords.near(y, x, u, v);
        }
        u += F(tile.u);
        v += F(tile.v);
        if (!source_tile.fits) {
          TapWindow<K, F> const window(p, u, v);
          grads.set(window.tx, window.ty);
#pragma unroll 1
          for (int k = 0; k < N; ++k) {
            F values[K][K];
            T const* const plane = p.x.row(tile.image, first + k, 0);
            F const fill = p.fill_value(b, first + k), gradient = F(read(grad[k * p.grad.channel_stride]));
            window.for_each(p, p.x.row_stride, p.x.step,
                            [&](int j, int i, int64_t at) { values[j][i] = at < 0 ? fill : F(read(plane[at])); });
            grads.add([&](int j, int i) { return values[j][i]; }, gradient);
          }
        }
        if (!p.coords.has_map()) {
          F const scale = reciprocal(coords.weight(y, x)), grad_u = grads.along_x * scale,
                  grad_v = grads.along_y * scale;
          F grad_map[] = {grad_u, grad_v, -(grad_u * u + grad_v * v)};
#pragma unroll
          for (int i = 0; i < 3; ++i) {
            if (grad_map[i] - grad_map[i] != 0) grad_map[i] = 0;  // coordinates at infinity have no gradient
            sums[3 * i] += grad_map[i] * F(x);
            sums[3 * i + 1] += grad_map[i] * F(y);
            sums[3 * i + 2] += grad_map[i];
          }
        } else {
          F &to_x = p.grad_x.row(b, 0, y)[x], &to_y = p.grad_y.row(b, 0, y)[x];
          to_x = grads.along_x * p.coords.scale[0] + (first > 0 ? to_x : 0);
          to_y = grads.along_y * p.coords.scale[1] + (first > 0 ? to_y : 0);
        }
      }
    });
  }
  if (p.coords.has_map()) return;
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x - tiles.first_block) * 9);
}

// Adds up the sums of sample b.
template <class T>
__device__ __forceinline__ void reduce_matrix_sums(WarpMatrixBackward<T> const& p, int64_t b) {
  double* const total = sum_rows<kThreads, 9>(p.sums + b * p.parts * 9, p.parts);
  MatrixUse const& use = p.coords.use;
  if (threadIdx.x == 0)
    homography_vjp(p.coords.matrices + b * p.coords.matrix_stride, use, total, p.grad + b * 3 * use.rows);
}

}  // namespace
}  // namespace kv::geometry::cuda
