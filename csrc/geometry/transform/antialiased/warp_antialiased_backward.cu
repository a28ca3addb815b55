// The gradients of antialiased sampling on CUDA: atomic additions to the images, sums to matrices, one number for each
// coordinate of maps.
#include <cstdlib>

#include "core/block_reduce.cuh"
#include "geometry/transform/antialiased/gather_covered.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads)
    scatter_covered(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, bool some_gather) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  if (some_gather) {
    __shared__ bool gathers;
    if (threadIdx.x == 0) {
      tile.locate(tiles, 0);
      gathers = GatherShape<F>(homography(p.coords.matrices + tile.b * p.coords.matrix_stride, p.coords.use)).gathers;
    }
    __syncthreads();
    if (gathers) return;
  }
  tile.init_for_block(tiles, p);
  int const width = int(p.grad.width), height = int(p.grad.height), x = tile.x + int(threadIdx.x) % 32;
  int64_t const source = p.grad_x.width, plane = p.grad_x.height * source;
  F* const planes = p.sums + tile.image * p.grad_x.channels * plane;
  TilePixels<F> const pixels(p.coords, tile);
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32; y < min(tile.y + kTile, height); y += kThreads / 32) {
    CoveredPixel<F> const own = pixels.at(p, y, min(x, width - 1));
    bool const inside = __all_sync(kAllLanes, own.inside);
    dispatch_across(own, [&](auto threads) {
      constexpr int kThreadsEach = threads.value;
      for_each_time<kThreadsEach>(own, pixels.varies,
                                  [&](int, int lane, CoveredTaps<F> const& taps, Footprint<F> const& f) {
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
                                        for_each_tap<kThreadsEach>(p, taps, [&](int row, int column, F dx, F dy) {
                                          if ((row | column) >= 0)
                                            add(weight_of(f, dx, dy), row * int(source) + column);
                                        });
                                    });
                                  });
    });
  }
}

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

template <class T>
__global__ void __launch_bounds__(kThreads)
    differentiate_covered(__grid_constant__ AntialiasedCoordsBackward<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  tile.init_for_block(tiles, p);
  int const width = int(p.grad.width), height = int(p.grad.height), lane = threadIdx.x % 32, x = tile.x + lane;
  TilePixels<F> const pixels(p.coords, tile);
  F sums[9] = {};
#pragma unroll 1
  for (int y = tile.y + int(threadIdx.x) / 32; y < min(tile.y + kTile, height); y += kThreads / 32) {
    CoveredPixel<F> const own = pixels.at(p, y, min(x, width - 1));
    TapSums<F> kept;
    for_each_time<kGradientThreads>(
        own, pixels.varies, [&](int time, int source, CoveredTaps<F> const& taps, Footprint<F> const& f) {
          T const* const grad = p.grad.row(tile.b, 0, y) + min(tile.x + source, width - 1) * p.grad.step;
          TapSums<F> part;
          for_each_tap<kGradientThreads>(p, taps, [&](int row, int column, F dx, F dy) {
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
  if (!p.coords.has_map()) store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * 9);
}

template <class F>
__global__ void __launch_bounds__(kThreads) add_differences(__grid_constant__ MapDifferencesBackward<F> const p) {
  int64_t const pixels = p.grad_x.height * p.grad_x.width, i = int64_t(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= p.grad_x.batch * pixels) return;
  int64_t const b = i / pixels, at = i - b * pixels, y = at / p.grad_x.width;
  p.add(b, y, at - y * p.grad_x.width);
}

}  // namespace

template <class T>
int sample_antialiased_image_backward(SampleImageBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  char const* const text = std::getenv("KV_VARIANT");
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width, 1);
  bool const gathers = !p.coords.has_map() && p.x_axis.padding == Padding::fill && p.is_one_sample_per_image() &&
                       !(text && std::atoi(text) >= 100);
  if (gathers) {
    TileGrid const sources(p.grad_x.batch, p.grad_x.height, p.grad_x.width, 1);
    int const together = sizeof(T) == 8 || p.grad_x.channels < 3 ? 1 : 3;
    int const bytes = together * GatherShape<F>::kColumns * GatherShape<F>::kRows * int(sizeof(F));
    gather_covered<T><<<sources.blocks, kThreads, bytes, stream>>>(p, sources);
  } else {
    int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
    cudaError_t const error = cudaMemsetAsync(p.sums, 0, size_t(count) * sizeof(F), stream);
    if (error != cudaSuccess) return error;
  }
  if (tiles.blocks > 0) scatter_covered<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles, gathers);
  return cudaGetLastError();
}

template <class T>
int sample_antialiased_coords_backward(AntialiasedCoordsBackward<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width, 1);
  differentiate_covered<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int map_differences_backward(MapDifferencesBackward<T> const& p, CUstream_st* stream) {
  int64_t const pixels = p.grad_x.batch * p.grad_x.height * p.grad_x.width;
  add_differences<T><<<unsigned(ceil_div(pixels, int64_t(kThreads))), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_antialiased_image_backward, SampleImageBackward)
KV_INSTANTIATE(sample_antialiased_coords_backward, AntialiasedCoordsBackward)
KV_INSTANTIATE_COMPUTED(map_differences_backward, MapDifferencesBackward)

}  // namespace kv::geometry::cuda
