// Antialiased sampling on CUDA; antialiased.cuh has the order of the work. Taps are read from global memory by way of
// the L1.
#include "geometry/transform/antialiased/antialiased.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kChannelsTogether = 3;

// The taps of a pixel that are not all in bounds, or not all finite: one of weight 0 contributes nothing.
template <int Across, int N, class T, class F>
__device__ __noinline__ void add_carefully(Sample<T> const& p, Tile<F> const& tile, int first,
                                           CoveredTaps<F> const& taps, Footprint<F> const& f, F& total, F (&sums)[N]) {
  for_each_tap<Across>(p, taps, [&](int row, int column, F dx, F dy) {
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

template <class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 4)
    sample_covered(__grid_constant__ Sample<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  tile.init_for_block(tiles, p);
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

}  // namespace

template <class T>
int sample_antialiased(Sample<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.y.batch, p.y.height, p.y.width, 1);
  sample_covered<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased, Sample)

}  // namespace kv::geometry::cuda
