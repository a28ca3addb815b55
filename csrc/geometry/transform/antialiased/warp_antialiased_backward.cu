// The gradients of antialiased sampling on CUDA: gathered to the images of affine maps, by atomic additions to others,
// sums to matrices, one number for each coordinate of maps.
#include "core/block_reduce.cuh"
#include "geometry/transform/antialiased/covered_parts.cuh"
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

// A block has `chunk` tiles, one after the other. Samples that are gathered have nothing to scatter where out of bounds
// is the fill.
template <class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 1 : 3)
    scatter_covered(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, unsigned chunk,
                    bool some_gather) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  __shared__ bool gathers;
  unsigned const of_sample = tiles.across * tiles.down, end = min((blockIdx.x + 1) * chunk, tiles.blocks);
#pragma unroll 1
  for (unsigned number = blockIdx.x * chunk; number < end; ++number) {
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

template <class T>
__global__ void __launch_bounds__(kThreads)
    differentiate_covered(__grid_constant__ AntialiasedCoordsBackward<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  tile.init_for_block(tiles, p);
  F sums[9] = {};
  differentiate_unstaged(p, tile, sums);
  if (!p.coords.has_map()) store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * 9);
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

template <class T>
__global__ void __launch_bounds__(kThreads, 2)
    differentiate_by_parts(__grid_constant__ AntialiasedCoordsBackward<T> const p, TileGrid tiles, bool aligned) {
  using F = Compute<T>;
  __shared__ __align__(16) unsigned char shared_tiles[sizeof(TileInParts<F>)];
  extern __shared__ __align__(16) unsigned char memory[];
  auto& own = *reinterpret_cast<TileInParts<F>*>(shared_tiles);
  int const width = int(p.grad.width), height = int(p.grad.height);
  own.init(tiles, p, width, height);
  F sums[9] = {};
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
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * 9);
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
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width, 1);
  bool const gathers = !p.coords.has_map() && p.is_one_sample_per_image();
  if (gathers) {
    auto const& x = p.grad_x;
    unsigned const across = unsigned(ceil_div(x.width, kGatherTile)), down = unsigned(ceil_div(x.height, kGatherTile));
    int const together = sizeof(T) == 8 || p.grad_x.channels < 3 ? 1 : 3;
    int const bytes = together * GatherShape<F>::kColumns * GatherShape<F>::kRows * int(sizeof(F));
    unsigned const blocks = unsigned(x.batch) * across * down;
    if (blocks > 0) gather_covered<T><<<blocks, kThreads, bytes, stream>>>(p, across, down);
  } else {
    int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
    cudaError_t const error = cudaMemsetAsync(p.sums, 0, size_t(count) * sizeof(F), stream);
    if (error != cudaSuccess) return error;
  }
  // An affine map is gathered but for few: most blocks would only find that out.
  unsigned const chunk =
      gathers && p.coords.use.rows == 2 ? unsigned(ceil_div(int(tiles.blocks), 4 * multiprocessors())) : 1;
  if (tiles.blocks > 0)
    scatter_covered<T><<<ceil_div(tiles.blocks, chunk), kThreads, 0, stream>>>(p, tiles, chunk, gathers);
  return cudaGetLastError();
}

template <class T>
int sample_antialiased_coords_backward(AntialiasedCoordsBackward<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width, 1);
  if constexpr (sizeof(T) < 8) {
    if (!p.coords.has_map()) {
      differentiate_by_parts<T>
          <<<tiles.blocks, kThreads, PartTiles::bytes(p.x.channels), stream>>>(p, tiles, rows_are_fours(p.x));
      return cudaGetLastError();
    }
  }
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
