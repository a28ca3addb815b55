// Tiles of places and windows of taps on CUDA. Included by sample*.cu.
//
// A block takes a tile of kTile x kTile places, a warp 8 x 4 of them at a time: the taps of a turned image then lie in
// few rows, and what a warp writes still fills whole sectors of memory.
#pragma once

#include "core/launch.cuh"
#include "taps.h"

namespace kv::cuda {

constexpr int kThreads = 256;
constexpr int kRuns = kTile * kTile / kThreads;  // places a thread takes

// --- where places come from
// ----------------------------------------------------------------------------------------------

// A matrix, inverted in double by one thread of each block.
template <class F>
struct ByMatrix {
  Homography<F> map;
  __device__ __forceinline__ ByMatrix(Places<F> const& places, Homography<F>& shared, int64_t b) {
    if (threadIdx.x == 0) shared = homography(places.matrices + b * places.matrix_stride, places.use);
    __syncthreads();
    map = shared;
  }
  __device__ __forceinline__ void at(int64_t, int y, int x, F& u, F& v) const { map.at(F(x), F(y), u, v); }
};

template <class F>
struct ByMap {
  Places<F> const& places;
  __device__ __forceinline__ ByMap(Places<F> const& places, Homography<F>&, int64_t) : places(places) {}
  __device__ __forceinline__ void at(int64_t b, int y, int x, F& u, F& v) const {
    u = places.x.row(b, 0, y)[x * places.x.step] * places.scale[0] + places.offset[0];
    v = places.y.row(b, 0, y)[x * places.y.step] * places.scale[1] + places.offset[1];
  }
};

// --- tiles
// ---------------------------------------------------------------------------------------------------

struct Tiles {
  unsigned across, down, count;
  Tiles(int64_t batch, int64_t height, int64_t width)
      : across(unsigned(ceil_div(width, kTile))),
        down(unsigned(ceil_div(height, kTile))),
        count(unsigned(batch * across * down)) {}
  // The sample of the block's tile, and its first place.
  __device__ __forceinline__ void place(int64_t& b, int& y, int& x) const {
    unsigned const row = blockIdx.x / across;
    b = row / down;
    x = int(blockIdx.x - row * across) * kTile;
    y = int(row - unsigned(b) * down) * kTile;
  }
};

// The run-th place of a thread in its tile.
__device__ __forceinline__ int column_in_tile() { return threadIdx.x % 8 + threadIdx.x / 32 % 4 * 8; }
__device__ __forceinline__ int row_in_tile(int run) {
  return threadIdx.x % 32 / 8 + threadIdx.x / 128 * 4 + run * (kTile / kRuns);
}

// --- windows
// -------------------------------------------------------------------------------------------------------

// The K x K taps around a place.
template <int K, class F>
struct Window {
  F tx, ty;
  int x, y;  // the first tap
  bool inside;

  template <class T>
  __device__ __forceinline__ Window(Sampling<T> const& p, F u, F v) {
    x = first_tap<K, F>(near_image(p.x_axis, u), tx);
    y = first_tap<K, F>(near_image(p.y_axis, v), ty);
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

template <int K>
constexpr int kAtOnce = K == 4 ? 1 : 3;  // channels whose taps a thread asks for before it waits for them

// Calls run(by map or matrix, taps along an axis) with what p says, as types.
template <class T, class F>
void with_kind(Sampling<T> const& p, F run) {
  bool const by_matrix = p.places.matrices != nullptr;
  auto const with_taps = [&](auto by) {
    switch (p.interpolation) {
      case Interpolation::nearest:
        return run(by, std::integral_constant<int, 1>{});
      case Interpolation::bilinear:
        return run(by, std::integral_constant<int, 2>{});
      case Interpolation::bicubic:
        return run(by, std::integral_constant<int, 4>{});
    }
  };
  if (by_matrix)
    with_taps(std::true_type{});
  else
    with_taps(std::false_type{});
}
template <bool matrix, class F>
using By = std::conditional_t<matrix, ByMatrix<F>, ByMap<F>>;

}  // namespace kv::cuda
