// Antialiased sampling on CUDA; antialiased.cuh has the order of the work. Taps are read from global memory by way of
// the L1.
#include "geometry/transform/antialiased/antialiased.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kChannelsTogether = 3;

template <class T>
__global__ void __launch_bounds__(kThreads) sample_covered(__grid_constant__ Sample<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  if (threadIdx.x == 0) {
    tile.init(tiles, p.coords);
    tile.image = p.image_of(tile.b);
  }
  __syncthreads();
  int const width = int(p.y.width), height = int(p.y.height), lane = threadIdx.x % 32, x = tile.x + lane;
  TilePixels<F> const pixels(p.coords, tile);
  int const row_stride = int(p.x.row_stride), step = int(p.x.step);
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32; y < min(tile.y + kTile, height); y += kThreads / 32) {
    CoveredPixel<F> const own = pixels.at(p, y, min(x, width - 1));
    bool const inside = __all_sync(kAllLanes, own.inside);
    dispatch_across(own, [&](auto threads) {
      constexpr int kThreadsEach = threads.value;
      for_each_channel_group<kChannelsTogether>(p.x.channels, [&](int first, auto number) {
        constexpr int N = number.value;
        F kept[N];
        for_each_time<kThreadsEach>(own, [&](int time, int, CoveredTaps<F> const& taps, Footprint<F> const& f) {
          T const* const plane = p.x.row(tile.image, first, 0);
          F sums[N] = {}, total = 0;
          for_each_tap<kThreadsEach>(p, taps, inside, [&](int row, int column, F dx, F dy) {
            F const w = weight_of(f, dx, dy);
            if (!(w > 0)) return;  // a tap of weight 0 contributes nothing, even if it is inf or NaN
            total += w;
            if ((row | column) >= 0) {
              T const* const at = plane + (row * row_stride + column * step);
#pragma unroll
              for (int k = 0; k < N; ++k) sums[k] += w * F(read(at[k * p.x.channel_stride]));
            } else {
#pragma unroll
              for (int k = 0; k < N; ++k) sums[k] += w * p.fill_value(tile.b, first + k);
            }
          });
          total = sum_of_parts<kThreadsEach>(total);
#pragma unroll
          for (int k = 0; k < N; ++k) {
            F const mean = sum_of_parts<kThreadsEach>(sums[k]) / total;
            if (lane / (32 / kThreadsEach) == time) kept[k] = mean;
          }
        });
        if (x >= width) return;
#pragma unroll
        for (int k = 0; k < N; ++k)
          p.y.row(tile.b, first + k, y)[x * p.y.step] =
              round_to<T>(own.is_outside() ? p.fill_value(tile.b, first + k) : kept[k]);
      });
    });
  }
}

}  // namespace

template <class T>
int sample_antialiased(Sample<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.y.batch, p.y.height, p.y.width, 1);
  sample_covered<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased, Sample)

}  // namespace kv::geometry::cuda
