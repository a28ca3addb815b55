// Tiles of sampling coordinates and windows of taps on CUDA.
//
// A block takes a tile of kTile x kTile coords, a warp 8 x 4 of them at a time: the taps of a rotated image then lie in
// few rows, and what a warp writes still fills whole sectors of memory.
#pragma once

#include "core/block_reduce.cuh"
#include "core/launch.cuh"
#include "geometry/transform/taps.h"

namespace kv::geometry::cuda {

constexpr int kThreads = 256;
constexpr int kPixelsPerThread = kTile * kTile / kThreads;  // sampling coordinates of a thread
constexpr int kRowStep = kTile / kPixelsPerThread;          // rows from one to the next

// --- tiles -----------------------------------------------------------------------------------------------------------

// The tiles of an output. A block takes `per_block` of them in turn, because the setup before the first tile takes as
// long as a tile: adjacent ones, or, where all samples have the same sampling coordinates, the same tile of several
// samples.
struct TileGrid {
  unsigned per_block, across, down, blocks;
  bool of_samples;
  unsigned first_block = 0;  // of those of a launch
  KV_HD TileGrid(int64_t batch, int64_t height, int64_t width, int per_block, bool of_samples = false)
      : per_block(unsigned(per_block)),
        across(unsigned(ceil_div(width, (of_samples ? 1 : per_block) * kTile))),
        down(unsigned(ceil_div(height, kTile))),
        blocks(unsigned(ceil_div(batch, of_samples ? per_block : 1) * across * down)),
        of_samples(of_samples) {}
};

// A tile, in shared memory, written by one thread: its sample, its first pixel, and the map of its sampling
// coordinates.
template <class F>
struct Tile {
  Homography<F> map;  // counts from (x, y), to (u, v)
  int64_t b, image;   // the sample, and the image that it reads
  int x, y, u, v;

  // The block's tile of that number.
  __device__ __forceinline__ void locate(TileGrid const& tiles, int number) {
    unsigned const block = blockIdx.x - tiles.first_block, row = block / tiles.across, sample = row / tiles.down;
    int const column = int(block - row * tiles.across), per_block = int(tiles.per_block);
    b = image = tiles.of_samples ? int(sample) * per_block + number : int(sample);
    x = (tiles.of_samples ? column : column * per_block + number) * kTile;
    y = int(row - sample * tiles.down) * kTile;
    u = v = 0;
  }
  // By a map to an image of that size.
  __device__ __forceinline__ void bind(Homography<double> const& whole, Size const& size) {
    double first_u, first_v;
    whole.apply(double(x), double(y), first_u, first_v);
    u = origin_near(first_u, size.width);
    v = origin_near(first_v, size.height);
    map = bind_to_tile<F>(whole, x, y, u, v);
  }
  __device__ __forceinline__ void init(TileGrid const& tiles, SampleCoords<F> const& coords, int number = 0) {
    locate(tiles, number);
    if (!coords.has_map()) bind(homography(coords.matrices + b * coords.matrix_stride, coords.use), coords.use.source);
  }
  // With the image that its sample reads. By all threads, which then see it.
  template <class Params>
  __device__ __forceinline__ void init_for_block(TileGrid const& tiles, Params const& p) {
    if (threadIdx.x == 0) {
      init(tiles, p.coords);
      image = p.image_of(b);
    }
    __syncthreads();
  }
};

// The first pixel of a thread in its tile; the next ones are kRowStep rows further down each. A warp takes 8 x 4
// coords, of types of two bytes 16 x 2: what it writes then fills sectors of memory. Where rows do not begin with a
// sector, it takes 32 x 1 of them: fewer sectors are filled in part.
template <class T>
constexpr int kAcross = sizeof(T) == 2 ? 4 : 3;  // how many side by side, as a power of two
constexpr int kWholeRow = 5;
__device__ __forceinline__ int column_in_tile(int across) {
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  return (lane & ((1 << across) - 1)) + ((warp & ((kTile >> across) - 1)) << across);
}
__device__ __forceinline__ int row_in_tile(int across) {
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  return (lane >> across) + (warp >> (5 - across) << (5 - across));
}
template <class T = float>
__device__ __forceinline__ int column_in_tile() {
  return column_in_tile(kAcross<T>);
}
template <class T = float>
__device__ __forceinline__ int row_in_tile() {
  return row_in_tile(kAcross<T>);
}

// --- sampling coordinates --------------------------------------------------------------------------------------------

// The coordinates of a map in a column, from row `y` on.
template <class F>
struct MapColumn {
  F const *u, *v;
  int u_stride, v_stride, y;
  F u_scale, v_scale, own, u_offset, v_offset;

  __device__ __forceinline__ MapColumn(SampleCoords<F> const& coords, int64_t b, int y, int x)
      : u(coords.x.row(b, 0, y) + x * coords.x.step),
        v(coords.y.row(b, 0, y) + x * coords.y.step),
        u_stride(int(coords.x.row_stride)),
        v_stride(int(coords.y.row_stride)),
        y(y),
        u_scale(coords.scale[0]),
        v_scale(coords.scale[1]),
        own(coords.own),
        u_offset(F(x) * coords.own + coords.offset[0]),
        v_offset(coords.offset[1]) {}
  __device__ __forceinline__ void at(int row, F& at_u, F& at_v) const {
    at_u = u[row * u_stride] * u_scale + u_offset;
    at_v = v[row * v_stride] * v_scale + (F(y + row) * own + v_offset);
  }
};

// The sampling coordinates of a tile, from its matrix or the maps.
template <class F>
struct TileCoords {
  SampleCoords<F> const& coords;
  Tile<F> tile;
  __device__ __forceinline__ TileCoords(SampleCoords<F> const& coords, Tile<F> const& tile)
      : coords(coords), tile(tile) {}
  // Counted from the tile's (u, v).
  __device__ __forceinline__ void near(int y, int x, F& u, F& v) const {
    if (!coords.has_map()) {
      tile.map.apply(F(x - tile.x), F(y - tile.y), u, v);
    } else {
      MapColumn<F>(coords, tile.b, y, x).at(0, u, v);
    }
  }
  __device__ __forceinline__ void at(int y, int x, F& u, F& v) const {
    near(y, x, u, v);
    u += F(tile.u);
    v += F(tile.v);
  }
  // The divisor of the coordinates.
  __device__ __forceinline__ F weight(int y, int x) const { return tile.map.weight(F(x - tile.x), F(y - tile.y)); }
};

// --- windows ---------------------------------------------------------------------------------------------------------

// The K x K taps around a sampling coordinate.
template <int K, class F>
struct TapWindow {
  F tx, ty;
  int x, y;  // the first tap
  bool inside;

  template <class T>
  __device__ __forceinline__ TapWindow(Sampling<T> const& p, F u, F v) {
    bool const reflects = p.x_axis.padding == Padding::reflection;  // then the other axis reflects, too
    x = first_tap<K, F>(reflects ? reflected(p.x_axis, u) : clamped(p.x_axis, u), tx);
    y = first_tap<K, F>(reflects ? reflected(p.y_axis, v) : clamped(p.y_axis, v), ty);
    inside = x >= 0 && x <= p.x_axis.size - K && y >= 0 && y <= p.y_axis.size - K;
  }
  // Calls tap(j, i, offset in the plane) for all taps, offset -1 where there is the fill.
  template <class T, class Tap>
  __device__ __forceinline__ void for_each(Sampling<T> const& p, int64_t row_stride, int64_t step, Tap tap) const {
    for (int j = 0; j < K; ++j) {
      int const py = pixel_at(p.y_axis, y + j);
      for (int i = 0; i < K; ++i) {
        int const px = pixel_at(p.x_axis, x + i);
        bool const exists = unsigned(py) < unsigned(p.y_axis.size) && unsigned(px) < unsigned(p.x_axis.size);
        tap(j, i, exists ? py * row_stride + px * step : int64_t(-1));
      }
    }
  }
};

// Calls run with the number of taps along an axis, as a type.
template <class F>
void dispatch_taps(Interpolation interpolation, F run) {
  switch (interpolation) {
    case Interpolation::nearest:
      return run(std::integral_constant<int, 1>{});
    case Interpolation::bilinear:
      return run(std::integral_constant<int, 2>{});
    case Interpolation::bicubic:
      return run(std::integral_constant<int, 4>{});
  }
}

}  // namespace kv::geometry::cuda
