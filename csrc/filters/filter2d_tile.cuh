// Tiles of an image in shared memory, for kernels that read each pixel many times.
#pragma once

#include "core/launch.cuh"
#include "filter2d.h"

namespace kv::filters::cuda {
namespace {

constexpr int kWidth = 128, kHeight = 32;  // output pixels of a tile
constexpr int kWarps = 4, kThreads = 32 * kWarps;
constexpr int kDown = kHeight / kWarps, kAcross = kWidth / 32;  // pixels of a thread
constexpr int64_t kMaxSharedBytes = 100 << 10;                  // two blocks share a multiprocessor

// The tiles of one channel of a plane. A tile is read with the pixels around it: `rows` rows of `pitch` columns, of
// which `lead` are to the left of the tile. `p` is the image that is divided into tiles, `read` the one whose pixels
// are loaded.
struct Tiles {
  int across, down, lead, pitch, rows;
  bool vectorized;  // the rows that are loaded are vectors of kPixels

  template <class T, class U>
  Tiles(Planes<T const> const& read, Planes<U> const& p, int before, int after, int rows)
      : across(int(ceil_div(p.width, kWidth))),
        down(int(ceil_div(p.height, kHeight))),
        lead((before + 7) / 8 * 8),
        pitch(lead + (kWidth + after + 7) / 8 * 8),
        rows(kHeight + rows),
        vectorized(is_vectorizable<kPixels<T>>(read)) {}
  // Those of an image of another size whose rows begin anywhere.
  template <class U>
  __device__ __forceinline__ Tiles of(Planes<U> const& p) const {
    Tiles own = *this;
    own.across = (int(p.width) + kWidth - 1) / kWidth, own.down = (int(p.height) + kHeight - 1) / kHeight;
    own.vectorized = false;
    return own;
  }
  int64_t bytes(int64_t numbers) const { return 4 * (int64_t(pitch) * rows + rows + numbers); }
};

// Loads a tile whose first row is row y0 of a plane; `sources` is scratch memory of one number for each row. V pixels
// at a time: kPixels<T> where rows are such vectors, else 1.
template <int V, class T>
__device__ __forceinline__ void load_tile_by(float* tile, int* sources, Tiles const& tiles, Planes<T const> const& p,
                                             int64_t plane, int64_t channel, Border border, int x0, int y0) {
  for (int row = threadIdx.x; row < tiles.rows; row += kThreads)
    sources[row] = border_index(border, y0 + row, int(p.height));
  __syncthreads();
  T const* const in = p.plane(plane) + channel;
  int const width = int(p.width), across = tiles.pitch / V, count = tiles.rows * across;
  auto const fetch = [&](int i) {
    int const row = i / across, x = x0 - tiles.lead + (i - row * across) * V;
    Vector<T, V> vector{};
    if (i >= count || sources[row] < 0) return vector;
    T const* const from = in + sources[row] * p.row_stride;
    if (V > 1 && x >= 0 && x < width) return *reinterpret_cast<Vector<T, V> const*>(from + x);
#pragma unroll
    for (int k = 0; k < V; ++k) {
      int const column = border_index(border, x + k, width);
      if (column >= 0) vector.v[k] = from[column * (V > 1 ? 1 : p.step)];
    }
    return vector;
  };
  constexpr int kInFlight = V > 1 ? 4 : 8;  // loads of a thread in flight
  for (int first = threadIdx.x; first < count; first += kInFlight * kThreads) {
    Vector<T, V> vectors[kInFlight];
#pragma unroll
    for (int n = 0; n < kInFlight; ++n) vectors[n] = fetch(first + n * kThreads);
#pragma unroll
    for (int n = 0; n < kInFlight; ++n) {
      int const i = first + n * kThreads;
      Vector<float, V> numbers;
#pragma unroll
      for (int k = 0; k < V; ++k) numbers.v[k] = read(vectors[n].v[k]);
      if (i < count) *reinterpret_cast<Vector<float, V>*>(tile + i * V) = numbers;
    }
  }
  __syncthreads();
}

template <class T>
__device__ __forceinline__ void load_tile(float* tile, int* sources, Tiles const& tiles, Planes<T const> const& p,
                                          int64_t plane, int64_t channel, Border border, int x0, int y0) {
  tiles.vectorized ? load_tile_by<kPixels<T>>(tile, sources, tiles, p, plane, channel, border, x0, y0)
                   : load_tile_by<1>(tile, sources, tiles, p, plane, channel, border, x0, y0);
}

}  // namespace
}  // namespace kv::filters::cuda
