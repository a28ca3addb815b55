// What a block samples antialiased by a matrix or a map on CUDA: the parts of a tile, or, where their source pixels fit
// no source tile, its pixels from global memory.
#pragma once

#include "geometry/transform/antialiased/covered_ring.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kBlocks = 4;  // on a multiprocessor at once

// The taps of a pixel that are not all in bounds, or not all finite: one of weight 0 contributes nothing.
template <int Across, int N, class T, class F>
__device__ __noinline__ void add_carefully(Sample<T> const& p, Tile<F> const& tile, int first,
                                           CoveredTaps<F> const& taps, Footprint<F> const& f, F& total, F (&sums)[N]) {
  for_each_tap<Across>(p, taps, [&](int row, int column, F dx, F dy, int, int) {
    F const w = weight_of(f, dx, dy);
    if (!(w > 0)) return;
    total += w;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      T const* const plane = p.x.row(tile.image, first + k, 0);
      sums[k] += w * ((row | column) < 0 ? p.fill_value(tile.b, first + k)
                                         : F(read(plane[row * p.x.row_stride + column * p.x.step])));
    }
  });
}

// A tile without a source tile: maps, strong shrinking. Rows are divided among blocks.
template <class T, class F>
__device__ __noinline__ void sample_unstaged(Sample<T> const& p, Tile<F> const& tile, int split, int splits) {
  constexpr int kWarps = kThreads / 32;
  int const width = int(p.y.width), height = int(p.y.height), lane = threadIdx.x % 32, x = tile.x + lane;
  TilePixels<F> const pixels(p.coords, tile);
  int const row_stride = int(p.x.row_stride), step = int(p.x.step);
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32 + split * kWarps; y < min(tile.y + kTile, height); y += splits * kWarps) {
    CoveredPixel<F> const own = pixels.at(p, y, min(x, width - 1));
    bool const inside = __all_sync(kAllLanes, own.inside);
    dispatch_across(own, [&](auto threads) {
      constexpr int kThreadsEach = threads.value;
      for_each_channel_group<kChannelsTogether>(p.x.channels, [&](int first, auto number) {
        constexpr int N = number.value;
        T const* planes[N];
#pragma unroll
        for (int k = 0; k < N; ++k) planes[k] = p.x.row(tile.image, first + k, 0);
        F kept[N], weight = 1;
        for_each_time<kThreadsEach>(
            own, pixels.varies, [&](int time, int, CoveredTaps<F> const& taps, Footprint<F> const& f) {
              F sums[N] = {}, total = 0, rest = 0;  // the rest is not 0 where a tap is no finite number
              if (inside) {
                for_each_tap_inside<kThreadsEach>(taps, f, row_stride, step, [&](F w, int at) {
                  total += w;
#pragma unroll
                  for (int k = 0; k < N; ++k) sums[k] += w * F(read(planes[k][at]));
                });
#pragma unroll
                for (int k = 0; k < N; ++k) rest += sums[k] - sums[k];
              }
              if (__any_sync(kAllLanes, !inside || rest != 0)) {
                total = 0;
#pragma unroll
                for (int k = 0; k < N; ++k) sums[k] = 0;
                add_carefully<kThreadsEach>(p, tile, first, taps, f, total, sums);
              }
              total = sum_of_parts<kThreadsEach>(total);
              bool const is_own = lane / (32 / kThreadsEach) == time;
              if (is_own) weight = total;
#pragma unroll
              for (int k = 0; k < N; ++k) {
                F const sum = sum_of_parts<kThreadsEach>(sums[k]);
                if (is_own) kept[k] = sum;
              }
            });
        if (x >= width) return;
        F const scale = 1 / weight;
#pragma unroll
        for (int k = 0; k < N; ++k)
          p.y.row(tile.b, first + k, y)[x * p.y.step] =
              round_to<T>(own.is_outside() ? p.fill_value(tile.b, first + k) : kept[k] * scale);
      });
    });
  }
}

// By a matrix, the parts of the block's tile that are its share where several blocks have one.
template <class T>
__device__ __forceinline__ void sample_tile_in_parts(Sample<T> const& p, TileGrid const& tiles, bool aligned) {
  using F = Compute<T>;
  __shared__ __align__(16) unsigned char shared_ring[sizeof(PartsRing<F>)];
  extern __shared__ __align__(16) unsigned char shared_parts[];
  auto& ring = *reinterpret_cast<PartsRing<F>*>(shared_ring);
  ring.whole.init(tiles, p, int(p.y.width), int(p.y.height), PartsRing<F>::kLogSide);
  int const split = int(blockIdx.y), splits = int(gridDim.y);
  if (ring.whole.plan.fits)
    sample_parts(p, ring, aligned, split, splits, shared_parts);
  else
    sample_unstaged(p, ring.whole.tile, split, splits);
}
constexpr int kPartsBytes = PartTiles::bytes(kChannelsTogether);  // of shared memory

// How many blocks share a tile: where all are at once, about as many as source pixels of a pixel; else so few that each
// has about eight parts, which are about as many.
inline unsigned blocks_of_tile(int64_t tiles, int64_t source_pixels, int64_t pixels) {
  int64_t const at_once = int64_t(multiprocessors()) * kBlocks, parts = source_pixels / pixels;
  return unsigned(clamp(max(min(parts, at_once / tiles), min(parts / 8, 5 * at_once / tiles)), int64_t(1), int64_t(8)));
}

}  // namespace
}  // namespace kv::geometry::cuda
