// What a block of threads samples on CUDA: a thread takes sampling coordinates of a tile one after the other, and all
// channels of each. Taps are read from a source tile in shared memory, or from global memory when the taps exceed what
// a source tile holds.
#pragma once

#include "geometry/transform/matrix_formula.cuh"
#include "geometry/transform/sample_unstaged.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K>
constexpr int kBlocks = sizeof(T) == 8 ? 2
                        : K == 4       ? 4
                                       : 5;  // on a multiprocessor at once; six are slower

// A separate kernel computes its matrices by a formula: its blocks wait for theirs first, and a run-time choice of
// where a matrix comes from would cost 2 to 4 % of the time.
template <int K, bool ByFormula, bool Aligned, class T>
__device__ __forceinline__ void sample_block(Sample<T> const& p, TileGrid const& tiles) {
  using F = Compute<T>;
  using Source = SourceTile<T, Aligned>;
  constexpr int across = !Aligned && sizeof(T) == 4 && K <= 2 ? kWholeRow : kAcross<T>;
  __shared__ BlockTiles<F> block;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.y.width), height = int(p.y.height);
  if constexpr (ByFormula) {
    F made[9];
    block.template prepare<K>(tiles, p, p.y.batch, width, height, [&](int64_t b) {
      make_plane_matrix(p.formula, b, made);
      return made;
    });
  } else {
    block.template prepare<K>(tiles, p, p.y.batch, width, height);
  }

#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block); ++number) {
    Tile<F> const& tile = block.tiles[number];
    if (tile.x >= width || tile.b >= p.y.batch) break;
    void* const kept = shared_pixels + Source::bytes(p.x.channels);
    if (!tiles.of_samples || number == 0) block.template find_taps<K>(number, p, width, height, kept, across);
    Source source_tile(shared_pixels, block.taps[tiles.of_samples ? 0 : number], p.x, p, F());
    int64_t const b = tile.b;
    int const x = tile.x + column_in_tile(across), y = tile.y + row_in_tile(across);
    for_each_channel_group<Source::kChannels>(p.x.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (source_tile.fits)
        source_tile.template load<N>(p.x, tile.image, first, p.x_axis, p.y_axis,
                                     [&](int c) { return p.fill ? round_to<T>(p.fill_value(b, c)) : T{}; });
      if (x >= width) return;
      F poison = 0;  // NaN where a tap is no finite number
      if (source_tile.fits) {
        T const* const origin = source_tile.origin(tile.u, tile.v);
        ThreadCoords<F> const thread_coords(tile, p.coords, kept, column_in_tile(across), row_in_tile(across));
        T* planes[N];
#pragma unroll
        for (int k = 0; k < N; ++k) planes[k] = p.y.row(b, first + k, 0);
        int to = y * int(p.y.row_stride) + x * int(p.y.step);  // a plane has less than 2^31 elements
        int const pitch = source_tile.pitch(), plane = source_tile.plane();
#pragma unroll 1
        for (int run = 0; run < kPixelsPerThread && y + run * kRowStep < height;
             ++run, to += kRowStep * int(p.y.row_stride)) {
          F u, v, tx, ty, wx[K], wy[K];
          thread_coords.at(run, u, v);
          int const column = near_tap<K>(u, tx), row = near_tap<K>(v, ty);
          T const* const taps = origin + (row * pitch + column);
          tap_weights(tx, wx);
          tap_weights(ty, wy);
#pragma unroll
          for (int k = 0; k < N; ++k) {
            F const sum = mean<K>(taps + k * plane, pitch, 1, tx, ty, wx, wy);
            if constexpr (sizeof(T) > 1 && K > 1) poison += sum * 0;
            planes[k][to] = round_to<T>(sum);
          }
        }
      }
      if (!source_tile.fits || poison != 0)
#pragma unroll 1
        for (int run = 0; run < kPixelsPerThread && y + run * kRowStep < height; ++run)
          sample_unstaged<K, N>(p, tile, first, y + run * kRowStep, x);
    });
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
