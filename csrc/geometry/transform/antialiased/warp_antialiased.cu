// Antialiased sampling on CUDA; antialiased.cuh has the order of the work. Taps are read from global memory by way of
// the L1.
#include <cstdlib>

#include "geometry/transform/antialiased/covered_parts.cuh"

namespace kv::geometry::cuda {
namespace {

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
  int const warps = int(blockDim.x) / 32;
  int const width = int(p.y.width), height = int(p.y.height), lane = threadIdx.x % 32, x = tile.x + lane;
  TilePixels<F> const pixels(p.coords, tile);
  int const row_stride = int(p.x.row_stride), step = int(p.x.step);
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32 + split * warps; y < min(tile.y + kTile, height); y += splits * warps) {
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

template <class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 4)
    sample_covered(__grid_constant__ Sample<T> const p, TileGrid tiles) {
  __shared__ Tile<Compute<T>> tile;
  tile.init_for_block(tiles, p);
  sample_unstaged(p, tile, 0, 1);
}

// A block has `chunk` tiles, one after the other, because finding the first one takes as long as sampling a part; where
// there are few, several blocks share one.
template <class T, class Parts, int Blocks>
__global__ void __launch_bounds__(Parts::kThreads, Blocks)
    sample_by_parts(__grid_constant__ Sample<T> const p, TileGrid const tiles, unsigned chunk, bool aligned) {
  using F = Compute<T>;
  __shared__ __align__(16) unsigned char shared_tiles[sizeof(TilesInParts<Parts, F>)];
  extern __shared__ __align__(16) unsigned char memory[];
  auto& own = *reinterpret_cast<TilesInParts<Parts, F>*>(shared_tiles);
  unsigned const first = blockIdx.x * chunk, end = first + chunk < tiles.blocks ? first + chunk : tiles.blocks;
#pragma unroll 1
  for (unsigned number = first; number < end; ++number) {
    own.init(tiles, p, number, number == first, int(p.y.width), int(p.y.height));
    if (own.plan.fits)
      sample_parts(p, own, aligned, int(blockIdx.y), int(gridDim.y), reinterpret_cast<F*>(memory));
    else
      sample_unstaged(p, own.tile, int(blockIdx.y), int(gridDim.y));
  }
}

}  // namespace

template <class T>
int sample_antialiased(Sample<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.y.batch, p.y.height, p.y.width, 1);
  if constexpr (sizeof(T) < 8) {
    char const* const text = std::getenv("KV_VARIANT");
    int const variant = text ? std::atoi(text) : 0;
    if (!p.coords.has_map() && variant < 100) {
      bool const aligned = rows_are_fours(p.x);
      auto const run = [&](auto parts, auto blocks, unsigned chunk) -> int {
        using Parts = decltype(parts);
        auto* const kernel = sample_by_parts<T, Parts, decltype(blocks)::value>;
        int const bytes = Parts::bytes(p.x.channels);
        if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
          return error;
        int64_t const at_once = int64_t(multiprocessors()) * decltype(blocks)::value, count = tiles.blocks;
        // Parts of a tile are about as many as the images are larger.
        int64_t const ratio = p.x.height * p.x.width / (p.y.height * p.y.width);
        if (chunk == 0) chunk = unsigned(clamp(count / (3 * at_once), int64_t(1), int64_t(8)));
        unsigned const splits =
            unsigned(clamp(min(ratio, 3 * at_once / max(count, int64_t(1))), int64_t(1), int64_t(8)));
        kernel<<<dim3(unsigned(ceil_div(count, chunk)), splits), Parts::kThreads, bytes, stream>>>(p, tiles, chunk,
                                                                                                   aligned);
        return cudaGetLastError();
      };
      using Small = PartTiles<64, 52, 256>;
      using Four = std::integral_constant<int, 4>;
      if (variant % 10 == 1)
        return run(PartTiles<96, 92, 512>{}, std::integral_constant<int, 2>{}, unsigned(variant) / 10);
      return run(Small{}, Four{}, unsigned(variant) / 10);
    }
  }
  sample_covered<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased, Sample)

}  // namespace kv::geometry::cuda
