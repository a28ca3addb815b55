// The taps of antialiased sampling on CUDA.
//
// A warp takes 32 adjacent pixels of a row of the output, and each thread finds the taps of one of them. Then the warp
// goes through 32 / Across pixels at a time, with Across threads for each, one for every Across-th column of taps: what
// they read together is adjacent in memory. Thread `part * (32 / Across) + pixel` is the part-th of its pixel; the
// result of the t-th time is kept by the threads of part t, so that each has that of its own pixel at the end.
#pragma once

#include "core/warp_reduce.cuh"
#include "geometry/transform/antialiased/warp_antialiased.h"
#include "geometry/transform/sampling.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr unsigned kAllLanes = 0xffffffffu;

// A pixel of the output: its coordinates and their derivatives, and its taps, none where all are the fill.
template <class F>
struct CoveredPixel {
  F u, v;  // of the caller's map
  Jacobian<F> slopes;
  Footprint<F> footprint;
  CoveredTaps<F> taps;
  bool inside;

  template <class T>
  __device__ __forceinline__ CoveredPixel(Sampling<T> const& p, F u, F v, Jacobian<F> const& slopes,
                                          Footprint<F> const& f)
      : u(u), v(v), slopes(slopes), footprint(f), taps(p, u, v, f), inside(taps.is_inside(p)) {
    if (taps.is_outside(p)) {
      taps.last_x = taps.first_x - 1;
      taps.last_y = taps.first_y - 1;
      inside = true;
    }
  }
  __device__ __forceinline__ bool is_outside() const { return taps.last_y < taps.first_y; }
};

// The pixels of a tile: rows of warps. Affine maps have one footprint.
template <class F>
struct TilePixels {
  SampleCoords<F> const& coords;
  Tile<F> const& tile;
  Footprint<F> whole;
  bool varies;

  __device__ __forceinline__ TilePixels(SampleCoords<F> const& coords, Tile<F> const& tile)
      : coords(coords), tile(tile), varies(coords.has_map() || !tile.map.affine) {
    if (!varies) whole = footprint(jacobian(tile.map, F(0), F(0), F(0), F(0)));
  }
  // In F, from relative coordinates.
  template <class T>
  __device__ __forceinline__ CoveredPixel<F> at(Sampling<T> const& p, int y, int x) const {
    F u, v;
    if (coords.has_map()) {
      MapColumn<F>(coords, tile.b, y, x).at(0, u, v);
      auto const slopes = jacobian(coords, tile.b, y, x);
      return {p, u, v, slopes, footprint(slopes)};
    }
    F const column = F(x - tile.x), row = F(y - tile.y);
    tile.map.apply(column, row, u, v);
    auto const slopes = jacobian(tile.map, column, row, u, v);
    return {p, u + F(tile.u), v + F(tile.v), slopes, varies ? footprint(slopes) : whole};
  }
};

template <class F>
__device__ __forceinline__ CoveredTaps<F> from_lane(CoveredTaps<F> taps, int lane) {
  taps.u = __shfl_sync(kAllLanes, taps.u, lane);
  taps.v = __shfl_sync(kAllLanes, taps.v, lane);
  taps.first_x = __shfl_sync(kAllLanes, taps.first_x, lane);
  taps.last_x = __shfl_sync(kAllLanes, taps.last_x, lane);
  taps.first_y = __shfl_sync(kAllLanes, taps.first_y, lane);
  taps.last_y = __shfl_sync(kAllLanes, taps.last_y, lane);
  return taps;
}
template <class F>
__device__ __forceinline__ Footprint<F> from_lane(Footprint<F> f, int lane) {
  f.xx = __shfl_sync(kAllLanes, f.xx, lane);
  f.xy = __shfl_sync(kAllLanes, f.xy, lane);
  f.yy = __shfl_sync(kAllLanes, f.yy, lane);
  return f;
}

// The sum over the threads of a pixel, for all of them.
template <int Across, class F>
__device__ __forceinline__ F sum_of_parts(F x) {
#pragma unroll
  for (int step = 32 / Across; step < 32; step *= 2) x += __shfl_xor_sync(kAllLanes, x, step);
  return x;
}

// Calls pixels(time, lane of the pixel, its taps, its footprint) for each time. `varies`: footprints differ.
template <int Across, class F, class Pixels>
__device__ __forceinline__ void for_each_time(CoveredPixel<F> const& own, bool varies, Pixels pixels) {
  constexpr int kTogether = 32 / Across;
#pragma unroll 1
  for (int time = 0; time < Across; ++time) {
    int const lane = time * kTogether + threadIdx.x % kTogether;
    pixels(time, lane, from_lane(own.taps, lane), varies ? from_lane(own.footprint, lane) : own.footprint);
  }
}

// Calls tap(row, column, dx, dy, j, i) for a thread's taps (j, i) of a pixel: pixels of the image, negative where there
// is the fill.
template <int Across, class T, class F, class Tap>
__device__ __forceinline__ void for_each_tap(Sampling<T> const& p, CoveredTaps<F> const& taps, Tap tap) {
  int const part = int(threadIdx.x % 32) / (32 / Across);
#pragma unroll 1
  for (int j = taps.first_y; j <= taps.last_y; ++j) {
    int const row = padded_pixel(p.y_axis, j);
    F const dy = F(j) - taps.v;
    for (int i = taps.first_x + part; i <= taps.last_x; i += Across)
      tap(row, padded_pixel(p.x_axis, i), F(i) - taps.u, dy, j, i);
  }
}

// Calls tap(weight, offset) for a thread's taps of a pixel in bounds, a column at a time: those beyond the last column
// have weight 0 by themselves. Offsets are in a plane.
template <int Across, class F, class Tap>
__device__ __forceinline__ void for_each_tap_inside(CoveredTaps<F> const& taps, Footprint<F> const& f, int row_stride,
                                                    int step, Tap tap) {
  int const part = int(threadIdx.x % 32) / (32 / Across), rows = taps.last_y - taps.first_y + 1;
  F const dy = F(taps.first_y) - taps.v;
#pragma unroll 1
  for (int first = taps.first_x; first <= taps.last_x; first += Across) {
    int const column = first + part;
    F const dx = F(column) - taps.u;
    F qx = f.xx * dx + f.xy * dy, qy = f.xy * dx + f.yy * dy;
    int at = taps.first_y * row_stride + min(column, taps.last_x) * step;
#pragma unroll 4
    for (int j = 0; j < rows; ++j) {
      tap(vsaturate(1 - vabs(qx)) * vsaturate(1 - vabs(qy)), at);
      qx += f.xy;
      qy += f.yy;
      at += row_stride;
    }
  }
}

template <class F>
__device__ __forceinline__ F weight_of(Footprint<F> const& f, F dx, F dy) {
  F const tx = 1 - vabs(f.xx * dx + f.xy * dy), ty = 1 - vabs(f.xy * dx + f.yy * dy);
  return vsaturate(tx) * vsaturate(ty);
}

// Calls run with how many threads a pixel gets, as a type, by the widest of a warp's windows.
template <class F, class Run>
__device__ __forceinline__ void dispatch_across(CoveredPixel<F> const& own, Run run) {
  int const widest = warp_reduce(own.taps.last_x - own.taps.first_x + 1, Max{});
  if (widest <= 2)
    run(std::integral_constant<int, 1>{});
  else if (widest <= 4)
    run(std::integral_constant<int, 4>{});
  else
    run(std::integral_constant<int, 8>{});
}

}  // namespace
}  // namespace kv::geometry::cuda
