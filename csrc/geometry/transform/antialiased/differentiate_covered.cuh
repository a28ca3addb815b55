// The gradients of sampling coordinates and matrices of antialiased sampling on CUDA.
#pragma once

#include "core/block_reduce.cuh"
#include "geometry/transform/antialiased/covered_parts.cuh"

namespace kv::geometry::cuda {
namespace {

// The sums of a pixel over its threads.
template <int Across, class F>
__device__ __forceinline__ void add_parts(TapSums<F>& sums) {
  sums.weight = sum_of_parts<Across>(sums.weight);
  sums.value = sum_of_parts<Across>(sums.value);
#pragma unroll
  for (int i = 0; i < 5; ++i) {
    sums.plain[i] = sum_of_parts<Across>(sums.plain[i]);
    sums.times[i] = sum_of_parts<Across>(sums.times[i]);
  }
}

constexpr int kGradientThreads = 4;  // for each pixel

// Adds the gradients of a tile to its sums, or writes those of maps. Taps are read from global memory.
template <class T, class F>
__device__ __forceinline__ void differentiate_unstaged(AntialiasedCoordsBackward<T> const& p, Tile<F> const& tile,
                                                       F (&sums)[9]) {
  int const width = int(p.grad.width), height = int(p.grad.height), lane = threadIdx.x % 32, x = tile.x + lane;
  TilePixels<F> const pixels(p.coords, tile);
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32; y < min(tile.y + kTile, height); y += kThreads / 32) {
    CoveredPixel<F> const own = pixels.at(p, y, min(x, width - 1));
    TapSums<F> kept;
    for_each_time<kGradientThreads>(
        own, pixels.varies, [&](int time, int source, CoveredTaps<F> const& taps, Footprint<F> const& f) {
          T const* const grad = p.grad.row(tile.b, 0, y) + min(tile.x + source, width - 1) * p.grad.step;
          TapSums<F> part;
          for_each_tap<kGradientThreads>(p, taps, [&](int row, int column, F dx, F dy, int, int) {
            F value = 0;
#pragma unroll 1
            for (int c = 0; c < p.x.channels; ++c) {
              F const pixel = (row | column) < 0 ? p.fill_value(tile.b, c)
                                                 : F(read(p.x.row(tile.image, c, row)[column * p.x.step]));
              value += F(read(grad[c * p.grad.channel_stride])) * pixel;
            }
            part.add(f, dx, dy, value);
          });
          add_parts<kGradientThreads>(part);
          if (lane / (32 / kGradientThreads) == time) kept = part;
        });
    if (x >= width) continue;
    F by_u = 0, by_v = 0;
    Jacobian<F> by_j{};
    if (!own.is_outside()) kept.gradients(Shrink<F>(own.slopes), own.footprint, by_u, by_v, by_j);
    if (CoveredTaps<F>::is_fixed(p.x_axis, own.u)) by_u = 0;
    if (CoveredTaps<F>::is_fixed(p.y_axis, own.v)) by_v = 0;
    if (!p.coords.has_map()) {
      F const weight = tile.map.weight(F(x - tile.x), F(y - tile.y));
      jacobian_vjp(tile.map, weight, F(x), F(y), own.u, own.v, own.slopes, by_u, by_v, by_j, sums);
    } else {
      p.grad_x.row(tile.b, 0, y)[x] = by_u * p.coords.scale[0];
      p.grad_y.row(tile.b, 0, y)[x] = by_v * p.coords.scale[1];
      p.grad_jacobian.row(tile.b, 0, y)[x] = by_j.ux * p.coords.scale[0];
      p.grad_jacobian.row(tile.b, 1, y)[x] = by_j.uy * p.coords.scale[0];
      p.grad_jacobian.row(tile.b, 2, y)[x] = by_j.vx * p.coords.scale[1];
      p.grad_jacobian.row(tile.b, 3, y)[x] = by_j.vy * p.coords.scale[1];
    }
  }
}

// The gradients of a part to the matrix, by N channels that are in shared memory, are added to sums. A thread takes a
// pixel.
template <int N, class T, class F>
__device__ __forceinline__ void differentiate_part(AntialiasedCoordsBackward<T> const& p, Tile<F> const& tile,
                                                   PartPlan<F> const& plan, PartBounds<F> const& part, int first,
                                                   int x0, int y0, F const* memory, F (&sums)[9]) {
  constexpr int Pitch = PartTiles::kPitch;
  int const width = int(p.grad.width), height = int(p.grad.height);
  int const pixels = 1 << (plan.log_columns + plan.log_rows);
  int const log_line = plan.along_x ? plan.log_columns : plan.log_rows;
#pragma unroll 1
  for (int number = threadIdx.x; number < pixels; number += kThreads) {
    int const along = number & ((1 << log_line) - 1), cross = number >> log_line;
    int const x = x0 + (plan.along_x ? along : cross), y = y0 + (plan.along_x ? cross : along);
    if (x >= width || y >= height) continue;
    F const column = F(x - tile.x), row = F(y - tile.y);
    F u, v;
    tile.map.apply(column, row, u, v);
    Jacobian<F> const slopes = jacobian(tile.map, column, row, u, v);
    Footprint<F> const f = plan.varies ? footprint(slopes) : plan.footprint;
    F const own_u = u + F(tile.u), own_v = v + F(tile.v);
    CoveredTaps<F> const taps(p, own_u, own_v, f);
    if (taps.is_outside(p)) continue;
    u -= F(part.left);
    v -= F(part.top);
    int const left = floor_to_int<F>(u - plan.reach_x) + 1, top = floor_to_int<F>(v - plan.reach_y) + 1;
    bool const fits = (!plan.varies || (f.reach_x <= plan.reach_x && f.reach_y <= plan.reach_y)) &&
                      unsigned(left) <= unsigned(part.columns - plan.taps_x) &&
                      unsigned(top) <= unsigned(part.rows - plan.taps_y);
    F grad[N];
#pragma unroll
    for (int k = 0; k < N; ++k) grad[k] = F(read(p.grad.row(tile.b, first + k, y)[x * p.grad.step]));
    TapSums<F> own;
    if (fits) {
      F const* at_row = memory + top * (N * Pitch) + left;
#pragma unroll 1
      for (int j = 0; j < plan.taps_y; ++j, at_row += N * Pitch) {
        F const dy = F(top + j) - v;
#pragma unroll 2
        for (int i = 0; i < plan.taps_x; ++i) {
          F value = 0;
#pragma unroll
          for (int k = 0; k < N; ++k) value += grad[k] * at_row[k * Pitch + i];
          own.add(f, F(left + i) - u, dy, value);
        }
      }
    } else {
#pragma unroll 1
      for (int j = taps.first_y; j <= taps.last_y; ++j) {
        int const from_row = padded_pixel(p.y_axis, j);
#pragma unroll 1
        for (int i = taps.first_x; i <= taps.last_x; ++i) {
          int const from = padded_pixel(p.x_axis, i);
          F value = 0;
#pragma unroll 1
          for (int k = 0; k < N; ++k)
            value +=
                grad[k] * ((from_row | from) < 0 ? p.fill_value(tile.b, first + k)
                                                 : F(read(p.x.row(tile.image, first + k, from_row)[from * p.x.step])));
          own.add(f, F(i) - taps.u, F(j) - taps.v, value);
        }
      }
    }
    F by_u = 0, by_v = 0;
    Jacobian<F> by_j{};
    own.gradients(Shrink<F>(slopes), f, by_u, by_v, by_j);
    if (CoveredTaps<F>::is_fixed(p.x_axis, own_u)) by_u = 0;
    if (CoveredTaps<F>::is_fixed(p.y_axis, own_v)) by_v = 0;
    jacobian_vjp(tile.map, tile.map.weight(column, row), F(x), F(y), own_u, own_v, slopes, by_u, by_v, by_j, sums);
  }
}

// How many blocks of threads a multiprocessor has at least.
template <class T>
constexpr int kDifferentiateBlocks = sizeof(T) == 8 ? 1 : 2;

// Writes the sums of the block's tile to a matrix.
template <class T>
__device__ __forceinline__ void differentiate_block(AntialiasedCoordsBackward<T> const& p, TileGrid const& tiles,
                                                    bool aligned) {
  using F = Compute<T>;
  F sums[9] = {};
  if constexpr (sizeof(T) < 8) {
    __shared__ __align__(16) unsigned char shared_tiles[sizeof(TileInParts<F>)];
    extern __shared__ __align__(16) unsigned char memory[];
    auto& own = *reinterpret_cast<TileInParts<F>*>(shared_tiles);
    int const width = int(p.grad.width), height = int(p.grad.height);
    own.init(tiles, p, width, height);
    // Parts of fewer pixels would leave most threads without one.
    if (own.plan.fits && own.plan.log_columns + own.plan.log_rows >= 6)
      own.for_each_part(width, height, [&](int x0, int y0) {
        PartBounds<F> const part = own.bounds(x0, y0, width, height);
        if (part.is_outside(own.tile, p)) return;
        for_each_channel_group<kChannelsTogether>(p.x.channels, [&](int first, auto together) {
          constexpr int N = together.value;
          stage_part<N>(p, own.tile, own.plan, part, aligned, first, reinterpret_cast<F*>(memory));
          differentiate_part<N>(p, own.tile, own.plan, part, first, x0, y0, reinterpret_cast<F const*>(memory), sums);
        });
      });
    else
      differentiate_unstaged(p, own.tile, sums);
  } else {
    __shared__ Tile<F> tile;
    tile.init_for_block(tiles, p);
    differentiate_unstaged(p, tile, sums);
  }
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x - tiles.first_block) * 9);
}

// The memory of a block.
template <class T>
int differentiate_bytes(int channels) {
  return sizeof(T) < 8 ? PartTiles::bytes(channels) : 0;
}

}  // namespace
}  // namespace kv::geometry::cuda
