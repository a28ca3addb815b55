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

// How many columns a warp takes of a tile, as a power of two.
template <class T, int K, bool Aligned>
constexpr int kSampleAcross = !Aligned && sizeof(T) == 4 && K <= 2 ? kWholeRow : kAcross<T>;

// All channels of a tile, from the source tile that has its taps if these fit. coords() has the coordinates of a
// thread, relative to the tile's (u, v).
template <int K, bool Aligned, class T, class F, class Coords>
__device__ __forceinline__ void sample_tile(Sample<T> const& p, Tile<F> const& tile, TapBounds const& box,
                                            void* shared_pixels, Coords coords) {
  using Source = SourceTile<T, Aligned>;
  constexpr int kColumns = kSampleAcross<T, K, Aligned>;
  int const width = int(p.y.width), height = int(p.y.height);
  Source source_tile(shared_pixels, box, p.x, p, F());
  int64_t const b = tile.b;
  int const x = tile.x + column_in_tile(kColumns), y = tile.y + row_in_tile(kColumns);
  for_each_channel_group<Source::kChannels>(p.x.channels, [&](int first, auto number) {
    constexpr int N = number.value;
    if (source_tile.fits)
      source_tile.template load<N>(p.x, tile.image, first, p.x_axis, p.y_axis,
                                   [&](int c) { return p.fill ? round_to<T>(p.fill_value(b, c)) : T{}; });
    if (x >= width) return;
    F poison = 0;  // NaN where a tap is no finite number
    if (source_tile.fits) {
      T const* const origin = source_tile.origin(tile.u, tile.v);
      auto const thread_coords = coords();
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

// --- by a matrix -----------------------------------------------------------------------------------------------------

// A separate kernel computes its matrices by a formula: its blocks wait for theirs first, and a run-time choice of
// where a matrix comes from would cost 2 to 4 % of the time.
template <int K, bool ByFormula, bool Aligned, class T>
__device__ __forceinline__ void sample_block(Sample<T> const& p, TileGrid const& tiles) {
  using F = Compute<T>;
  constexpr int kColumns = kSampleAcross<T, K, Aligned>;
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
    if (tile.x >= width) break;
    sample_tile<K, Aligned>(p, tile, block.taps[number], shared_pixels, [&] {
      return ThreadCoords<F>(tile, p.coords, nullptr, column_in_tile(kColumns), row_in_tile(kColumns));
    });
  }
}

// --- by a map --------------------------------------------------------------------------------------------------------

// Whether the rows of a map are whole vectors. Special case, H200: 1.0 to 1.04 times as fast as number by number.
template <class F>
KV_HD bool has_whole_vectors(SampleCoords<F> const& coords, int64_t width) {
  return width % (16 / int(sizeof(F))) == 0 && rows_are_aligned(coords.x) && rows_are_aligned(coords.y);
}

constexpr int kMapPlane = kTile * kTile;  // from u to v of a pixel

// The coordinates of a tile, in shared memory: rows of kTile, of which the columns are permuted so that those of a
// warp, 1 << Across columns of some rows, lie in different banks.
template <int Across, class F>
struct MapTile {
  static constexpr int kVectorSize = 16 / int(sizeof(F));
  F* const coords;

  static __device__ __forceinline__ int at(int row, int column) {
    return row * kTile + (column ^ ((row << Across) & (kTile - 1)));
  }
  // Reads the map of a tile. Pixels beyond the output have coordinates of some in it.
  __device__ __forceinline__ void load(SampleCoords<F> const& from, Tile<F> const& tile, int width, int height,
                                       bool by_vectors) const {
    int const tile_x = tile.x, tile_y = tile.y, last = height - 1 - tile_y;
    F const *u = from.x.row(tile.b, 0, tile_y), *v = from.y.row(tile.b, 0, tile_y);
    int const u_stride = int(from.x.row_stride), v_stride = int(from.y.row_stride);
    if (by_vectors) {
      constexpr int kVectors = kTile / kVectorSize, kRows = kThreads / kVectors;
      int const column = int(threadIdx.x) % kVectors * kVectorSize, x = min(tile_x + column, width - kVectorSize);
#pragma unroll
      for (int run = 0; run < kTile / kRows; ++run) {
        int const row = int(threadIdx.x) / kVectors + run * kRows, y = min(row, last);
        F* const to = coords + at(row, column);
        __pipeline_memcpy_async(to, u + (y * u_stride + x), 16);
        __pipeline_memcpy_async(to + kMapPlane, v + (y * v_stride + x), 16);
      }
    } else {
      int const column = int(threadIdx.x) % kTile, x = min(tile_x + column, width - 1);
      u += x * from.x.step, v += x * from.y.step;
#pragma unroll
      for (int run = 0; run < kPixelsPerThread; ++run) {
        int const row = int(threadIdx.x) / kTile + run * kRowStep, y = min(row, last);
        F* const to = coords + at(row, column);
        __pipeline_memcpy_async(to, u + y * u_stride, sizeof(F));
        __pipeline_memcpy_async(to + kMapPlane, v + y * v_stride, sizeof(F));
      }
    }
    __pipeline_commit();
    __pipeline_wait_prior(0);
  }
};

// The coordinates of a thread. kRowStep rows further down columns are permuted alike.
template <class F>
struct MapCoords {
  static constexpr int kStep = kRowStep * kTile;
  F* own;

  __device__ __forceinline__ void at(int run, F& u, F& v) const {
    u = own[run * kStep];
    v = own[run * kStep + kMapPlane];
  }
  // Makes them coordinates in pixels, clamped to next to the image, and adds their taps to the box of the block.
  template <int K, class T>
  __device__ __forceinline__ void bind(Sampling<T> const& p, int x, int y, int width, int height,
                                       TapBounds& box) const {
    SampleCoords<F> const& coords = p.coords;
    F const u_offset = F(min(x, width - 1)) * coords.own + coords.offset[0];
    F low_u, high_u, low_v, high_v, t;
#pragma unroll
    for (int run = 0; run < kPixelsPerThread; ++run) {
      F const v_offset = F(min(y + run * kRowStep, height - 1)) * coords.own + coords.offset[1];
      F u, v;
      at(run, u, v);
      u = clamped(p.x_axis, u * coords.scale[0] + u_offset);
      v = clamped(p.y_axis, v * coords.scale[1] + v_offset);
      own[run * kStep] = u;
      own[run * kStep + kMapPlane] = v;
      low_u = run ? ::fmin(low_u, u) : u, high_u = run ? ::fmax(high_u, u) : u;
      low_v = run ? ::fmin(low_v, v) : v, high_v = run ? ::fmax(high_v, v) : v;
    }
    TapBounds own_box{near_tap<K>(low_u, t), near_tap<K>(low_v, t), near_tap<K>(high_u, t) + K - 1,
                      near_tap<K>(high_v, t) + K - 1};
    own_box.merge_lanes<32>();
    if (threadIdx.x % 32 == 0) {
      atomicMin(&box.left, own_box.left);
      atomicMin(&box.top, own_box.top);
      atomicMax(&box.right, own_box.right);
      atomicMax(&box.bottom, own_box.bottom);
    }
  }
};

// `by_vectors`: the map has whole ones.
// Special case: maps. H200: 1.2 (256x256) to 1.4 (335x513) times as fast as their coordinates in the loop over samples
// of matrices, bytes 1.14 to 1.28.
template <int K, bool Aligned, class T>
__device__ __forceinline__ void remap_block(Sample<T> const& p, TileGrid const& tiles, bool by_vectors) {
  using F = Compute<T>;
  constexpr int kColumns = kSampleAcross<T, K, Aligned>;
  __shared__ Tile<F> tile;
  __shared__ TapBounds box;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.y.width), height = int(p.y.height);
  int const column = column_in_tile(kColumns), row = row_in_tile(kColumns);
  using Map = MapTile<kColumns, F>;
  Map const map{reinterpret_cast<F*>(shared_pixels + SourceTile<T, Aligned>::bytes(p.x.channels))};
  MapCoords<F> const coords{map.coords + Map::at(row, column)};
#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block); ++number) {
    bool const reads = number == 0 || !tiles.of_samples;
    __syncthreads();  // before the tile is overwritten
    if (threadIdx.x == 0) {
      tile.locate(tiles, number);
      tile.image = p.image_of(min(tile.b, p.y.batch - 1));
      // Taps of larger images are not found by sums of floats.
      if (reads) box = max(p.x_axis.size, p.y_axis.size) < 1 << 20 ? TapBounds::empty() : TapBounds::all();
    }
    __syncthreads();
    if (tile.x >= width || tile.b >= p.y.batch) break;
    if (reads) {
      map.load(p.coords, tile, width, height, by_vectors);
      __syncthreads();
      coords.template bind<K>(p, tile.x + column, tile.y + row, width, height, box);
      __syncthreads();
    }
    sample_tile<K, Aligned>(p, tile, box, shared_pixels, [&] { return coords; });
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
