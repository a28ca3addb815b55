// The gradient of the image of antialiased sampling on CUDA, by atomic additions: of all samples, or what
// gather_covered.cuh leaves of those that it gathers.
#pragma once

#include "geometry/transform/antialiased/gather_covered.cuh"

namespace kv::geometry::cuda {
namespace {

// The gradients of a tile; of a gathered sample the taps whose pixels are others, by the padding.
template <class T, class F>
__device__ __forceinline__ void scatter_tile(SampleImageBackward<T> const& p, Tile<F> const& tile, bool is_rest) {
  int const width = int(p.grad.width), height = int(p.grad.height), x = tile.x + int(threadIdx.x) % 32;
  int64_t const source = p.grad_x.width, plane = p.grad_x.height * source;
  F* const planes = p.sums + tile.image * p.grad_x.channels * plane;
  TilePixels<F> const pixels(p.coords, tile);
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32; y < min(tile.y + kTile, height); y += kThreads / 32) {
    CoveredPixel<F> const own = pixels.at(p, y, min(x, width - 1));
    // From the window to where the map takes it, which a reflection repeats.
    F const own_shift_x = vfloor(own.u - own.taps.u + F(0.5)), own_shift_y = vfloor(own.v - own.taps.v + F(0.5));
    bool const inside = __all_sync(kAllLanes, own.inside && !(is_rest && (own_shift_x != 0 || own_shift_y != 0)));
    if (is_rest && inside) continue;
    dispatch_across(own, [&](auto threads) {
      constexpr int kThreadsEach = threads.value;
      for_each_time<kThreadsEach>(
          own, pixels.varies, [&](int, int lane, CoveredTaps<F> const& taps, Footprint<F> const& f) {
            F const shift_x = __shfl_sync(kAllLanes, own_shift_x, lane),
                    shift_y = __shfl_sync(kAllLanes, own_shift_y, lane);
            auto const is_gathered = [&](int j, int i) {
              F const x = F(i) + shift_x, y = F(j) + shift_y;
              return is_rest && x >= 0 && x < F(p.x_axis.size) && y >= 0 && y < F(p.y_axis.size);
            };
            F total = 0;
            for_each_tap_inside<kThreadsEach>(taps, f, 0, 0, [&](F w, int) { total += w; });
            F const scale = 1 / sum_of_parts<kThreadsEach>(total);
            int const column_of_grad = tile.x + lane;
            if (column_of_grad >= width) return;
            T const* const grad = p.grad.row(tile.b, 0, y) + column_of_grad * p.grad.step;
            for_each_channel_group<3>(p.grad.channels, [&](int first, auto number) {
              constexpr int N = number.value;
              F g[N];
              F* to[N];
#pragma unroll
              for (int k = 0; k < N; ++k) {
                g[k] = F(read(grad[(first + k) * p.grad.channel_stride])) * scale;
                to[k] = planes + (first + k) * plane;
              }
              auto const add = [&](F w, int at) {
                if (!(w > 0)) return;
#pragma unroll
                for (int k = 0; k < N; ++k) atomicAdd(to[k] + at, w * g[k]);
              };
              if (inside)
                for_each_tap_inside<kThreadsEach>(taps, f, int(source), 1, add);
              else
                for_each_tap<kThreadsEach>(p, taps, [&](int row, int column, F dx, F dy, int j, int i) {
                  if ((row | column) >= 0 && !is_gathered(j, i)) add(weight_of(f, dx, dy), row * int(source) + column);
                });
            });
          });
    });
  }
}

// How many blocks of threads a multiprocessor has at least.
template <class T>
constexpr int kScatterBlocks = sizeof(T) == 8 ? 1 : 3;

// Tiles [begin, end), one after the other. Samples that are gathered have nothing to scatter where out of bounds is the
// fill.
template <class T>
__device__ __forceinline__ void scatter_tiles(SampleImageBackward<T> const& p, TileGrid tiles, unsigned begin,
                                              unsigned end, bool some_gather) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  __shared__ bool gathers;
  unsigned const of_sample = tiles.across * tiles.down;
#pragma unroll 1
  for (unsigned number = begin; number < end; ++number) {
    __syncthreads();  // before the tile is written again
    if (threadIdx.x == 0) {
      tiles.first_block = blockIdx.x - number;
      tile.init(tiles, p.coords);
      tile.image = p.image_of(tile.b);
      gathers = some_gather &&
                GatherShape<F>(homography(p.coords.matrices + tile.b * p.coords.matrix_stride, p.coords.use)).gathers;
    }
    __syncthreads();
    if (gathers && p.x_axis.padding == Padding::fill)
      number = (number / of_sample + 1) * of_sample - 1;
    else
      scatter_tile(p, tile, gathers);
  }
}

// How many tiles a block takes. An affine map is gathered but for few: most blocks would only find that out.
template <class T>
unsigned scattered_tiles(Sampling<T> const& p, int64_t tiles, bool some_gather) {
  return some_gather && p.coords.use.rows == 2 ? unsigned(ceil_div(tiles, int64_t(4 * multiprocessors()))) : 1;
}

}  // namespace
}  // namespace kv::geometry::cuda
