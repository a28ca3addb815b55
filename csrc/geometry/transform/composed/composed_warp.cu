// Chains of matrices and maps on CUDA. A thread walks back from pixels of the result and keeps the sampling coordinates
// in registers. It stores them, samples an image there, or differentiates the chain.
#include "geometry/transform/composed/composed_warp.h"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

// Computes the inverses of the matrices of sample b. Called by all threads of a block.
template <class F>
__device__ __forceinline__ void find_inverses(Chain<F> const& chain, int64_t b, Homography<F>* inverses) {
  if (int(threadIdx.x) < chain.count && chain.links[threadIdx.x].is_matrix())
    inverses[threadIdx.x] = narrowed<F>(chain.links[threadIdx.x].inverse(b));
  __syncthreads();
}

// The sampling coordinates of a thread's pixels of a tile: (x, y) and those below it. Coordinates of pixels out of
// bounds are not used.
template <class F>
struct ThreadWalk {
  F u[kPixelsPerThread], v[kPixelsPerThread];

  __device__ __forceinline__ ThreadWalk(Chain<F> const& chain, Homography<F> const* inverses, int64_t b, int x, int y) {
#pragma unroll
    for (int run = 0; run < kPixelsPerThread; ++run) u[run] = F(x), v[run] = F(y + run * kRowStep);
    walk(chain, inverses, b, u, v, [](F const* plane, int at) { return plane[at]; });
  }
};

// --- coordinates -----------------------------------------------------------------------------------------------------

template <class F>
__global__ void __launch_bounds__(kThreads)
    coords_of_tiles(__grid_constant__ ComposedCoords<F> const p, TileGrid tiles) {
  __shared__ Homography<F> inverses[kMaxLinks];
  Tile<F> tile;
  tile.locate(tiles, 0);
  find_inverses(p.chain, tile.b, inverses);
  int const x = tile.x + column_in_tile(kWholeRow), y = tile.y + row_in_tile(kWholeRow);
  ThreadWalk<F> const coords(p.chain, inverses, tile.b, x, y);
  if (x >= int(p.result.width)) return;
#pragma unroll
  for (int run = 0; run < kPixelsPerThread; ++run) {
    int const row = y + run * kRowStep;
    if (row >= int(p.result.height)) return;
    p.result.row(tile.b, 0, row)[x] = coords.u[run];
    p.result.row(tile.b, 1, row)[x] = coords.v[run];
  }
}

template <class F>
__global__ void __launch_bounds__(kThreads) differentiate_coords(__grid_constant__ ComposedCoordsBackward<F> const p) {
  __shared__ Homography<F> inverses[kMaxLinks];
  int64_t const b = blockIdx.y;
  int const width = int(p.grad.width), pixels = width * int(p.grad.height);
  find_inverses(p.chain, b, inverses);
  F sums[kMaxLinks][9] = {};
  int const first = int(blockIdx.x) * kBackwardPixels;
  for (int i = first + int(threadIdx.x); i < min(first + kBackwardPixels, pixels); i += kThreads) {
    int const y = i / width, x = i - y * width;
    int64_t const at = x * p.grad.step;
    walk_vjp(p.chain, inverses, b, F(x), F(y), p.grad.row(b, 0, y)[at], p.grad.row(b, 1, y)[at], sums,
             [&](int k, int64_t offset, F g) {
               Link<F> const& link = p.chain.links[k];
               if (p.grads[k] && g != 0) atomicAdd(p.grads[k] + 2 * b * link.height * link.width + offset, g);
             });
  }
  for (int k = 0; k < p.chain.count; ++k)
    if (p.chain.links[k].is_matrix() && p.grads[k])
      store_block_sums<kThreads>(sums[k], p.sums + ((b * p.parts + blockIdx.x) * p.chain.count + k) * 9);
}

// A block for each link of each sample.
template <class F>
__global__ void __launch_bounds__(kThreads) add_matrix_gradients(__grid_constant__ ComposedCoordsBackward<F> const p) {
  int const k = int(blockIdx.x);
  int64_t const b = blockIdx.y;
  Link<F> const& link = p.chain.links[k];
  if (!link.is_matrix() || !p.grads[k]) return;
  __shared__ double total[9];
  double sums[9] = {};
  for (int64_t part = threadIdx.x; part < p.parts; part += kThreads)
    for (int i = 0; i < 9; ++i) sums[i] += p.sums[((b * p.parts + part) * p.chain.count + k) * 9 + i];
  store_block_sums<kThreads>(sums, total);
  __syncthreads();
  if (threadIdx.x == 0) homography_vjp(link.of(b), link.use(), total, p.grads[k] + 9 * b);
}

// --- images ----------------------------------------------------------------------------------------------------------

// Samples N channels at (u, v) from global memory. Goes tap by tap at the border, and where a tap of weight 0, which
// contributes nothing, may be NaN or inf.
template <int N, class T>
__device__ __noinline__ void sample_unstaged(ComposedWarp<T> const& p, int64_t b, int first, int y, int x, float u,
                                             float v) {
  TapWindow<2, float> const window(p, u, v);
  int64_t const row = p.x.row_stride, step = p.x.step;
  T* const result = p.y.row(b, first, y) + x * p.y.step;
  if (window.inside) {
    T const* taps = p.x.row(b, first, window.y) + window.x * step;
    float poison = 0;
#pragma unroll
    for (int k = 0; k < N; ++k, taps += p.x.channel_stride) {
      float const a = read(taps[0]), c = read(taps[row]);
      float const above = a + window.tx * (read(taps[step]) - a), below = c + window.tx * (read(taps[row + step]) - c);
      float const sum = above + window.ty * (below - above);
      poison += sum * 0;
      result[k * p.y.channel_stride] = round_to<T>(sum);
    }
    if (poison == 0) return;
  }
  float wx[2], wy[2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
#pragma unroll 1
  for (int k = 0; k < N; ++k) {
    T const* const plane = p.x.row(b, first + k, 0);
    float const fill = p.fill_value(b, first + k);
    float sum = 0;
    window.for_each(p, row, step, [&](int j, int i, int64_t at) {
      float const weight = wx[i] * wy[j];
      if (weight != 0) sum += weight * (at < 0 ? fill : read(plane[at]));
    });
    result[k * p.y.channel_stride] = round_to<T>(sum);
  }
}

// As in sampling.cu, a block takes tiles of the result and loads what they read into shared memory.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads, 4)
    sample_bilinear(__grid_constant__ ComposedWarp<T> const p, TileGrid tiles) {
  using Source = SourceTile<T, Aligned>;
  constexpr int across = !Aligned && sizeof(T) == 4 ? kWholeRow : kAcross<T>;
  __shared__ Homography<float> inverses[kMaxLinks];
  __shared__ TapBounds boxes[kMaxTilesPerBlock];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.y.width), height = int(p.y.height);
  // Coordinates that are near the image have their taps near, see near_tap.
  bool const fits_taps = max(p.x_axis.size, p.y_axis.size) < (1 << 20);
  Tile<float> tile;
  tile.locate(tiles, 0);
  if (threadIdx.x < kMaxTilesPerBlock) boxes[threadIdx.x] = fits_taps ? TapBounds::empty() : TapBounds::all();
  find_inverses(p.chain, tile.b, inverses);
  int64_t const b = tile.b;

#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block) && tile.x < width; ++number, tile.x += kTile) {
    int const x = tile.x + column_in_tile(across), y = tile.y + row_in_tile(across);
    ThreadWalk<float> const coords(p.chain, inverses, b, x, y);
    auto const exists = [&](int run) { return x < width && y + run * kRowStep < height; };
    TapBounds box = TapBounds::empty();
#pragma unroll
    for (int run = 0; run < kPixelsPerThread; ++run) {
      float t;
      int const column = near_tap<2>(clamped(p.x_axis, coords.u[run]), t),
                row = near_tap<2>(clamped(p.y_axis, coords.v[run]), t);
      if (exists(run))
        box = {min(box.left, column), min(box.top, row), max(box.right, column + 1), max(box.bottom, row + 1)};
    }
    box = {warp_reduce(box.left, Min()), warp_reduce(box.top, Min()), -warp_reduce(-box.right, Min()),
           -warp_reduce(-box.bottom, Min())};
    if (threadIdx.x % 32 == 0) {
      atomicMin(&boxes[number].left, box.left);
      atomicMin(&boxes[number].top, box.top);
      atomicMax(&boxes[number].right, box.right);
      atomicMax(&boxes[number].bottom, box.bottom);
    }
    __syncthreads();
    Source source_tile(shared_pixels, boxes[number], p.x, p, 0.f);
    for_each_channel_group<Source::kChannels>(p.x.channels, [&](int first, auto channels) {
      constexpr int N = channels.value;
      float poison = 0;  // NaN where a tap is no finite number
      if (source_tile.fits) {
        source_tile.template load<N>(p.x, b, first, p.x_axis, p.y_axis,
                                     [&](int c) { return p.fill ? round_to<T>(p.fill_value(b, c)) : T{}; });
        T const* const origin = source_tile.origin(0, 0);
        int const pitch = source_tile.pitch(), plane = source_tile.plane();
        T* planes[N];
#pragma unroll
        for (int k = 0; k < N; ++k) planes[k] = p.y.row(b, first + k, 0);
        int to = y * int(p.y.row_stride) + x * int(p.y.step);  // a plane has less than 2^31 elements
#pragma unroll
        for (int run = 0; run < kPixelsPerThread; ++run, to += kRowStep * int(p.y.row_stride)) {
          if (!exists(run)) break;
          float tx, ty;
          int const column = near_tap<2>(clamped(p.x_axis, coords.u[run]), tx),
                    row = near_tap<2>(clamped(p.y_axis, coords.v[run]), ty);
          T const* const taps = origin + (row * pitch + column);
#pragma unroll
          for (int k = 0; k < N; ++k) {
            auto const at = [&](int j, int i) { return read(taps[k * plane + j * pitch + i]); };
            float const above = at(0, 0) + tx * (at(0, 1) - at(0, 0)), below = at(1, 0) + tx * (at(1, 1) - at(1, 0));
            float const sum = above + ty * (below - above);
            if constexpr (sizeof(T) > 1) poison += sum * 0;
            planes[k][to] = round_to<T>(sum);
          }
        }
      }
      if (!source_tile.fits || poison != 0)
#pragma unroll
        for (int run = 0; run < kPixelsPerThread; ++run)
          if (exists(run)) sample_unstaged<N>(p, b, first, y + run * kRowStep, x, coords.u[run], coords.v[run]);
    });
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) sample_nearest(__grid_constant__ ComposedWarp<T> const p, TileGrid tiles) {
  __shared__ Homography<float> inverses[kMaxLinks];
  Tile<float> tile;
  tile.locate(tiles, 0);
  find_inverses(p.chain, tile.b, inverses);
  int const x = tile.x + column_in_tile<T>(), y = tile.y + row_in_tile<T>();
  ThreadWalk<float> const coords(p.chain, inverses, tile.b, x, y);
  if (x >= int(p.y.width)) return;
  int from[kPixelsPerThread];  // -1 for the fill
#pragma unroll
  for (int run = 0; run < kPixelsPerThread; ++run)
    TapWindow<1, float>(p, coords.u[run], coords.v[run])
        .for_each(p, p.x.row_stride, p.x.step, [&](int, int, int64_t at) { from[run] = int(at); });
  int const rows = min(kPixelsPerThread, (int(p.y.height) - y + kRowStep - 1) / kRowStep);
#pragma unroll 1
  for (int c = 0; c < p.x.channels; ++c) {
    T const* const plane = p.x.row(tile.b, c, 0);
    T const fill = round_to<T>(p.fill_value(tile.b, c));
    T* const to = p.y.row(tile.b, c, y) + x * p.y.step;
    T values[kPixelsPerThread];
#pragma unroll
    for (int run = 0; run < kPixelsPerThread; ++run) values[run] = from[run] < 0 ? fill : plane[from[run]];
#pragma unroll
    for (int run = 0; run < kPixelsPerThread; ++run)
      if (run < rows) to[run * kRowStep * p.y.row_stride] = values[run];
  }
}

}  // namespace

template <class T>
int composed_coords(ComposedCoords<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.result.batch, p.result.height, p.result.width, 1);
  coords_of_tiles<<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int composed_coords_backward(ComposedCoordsBackward<T> const& p, CUstream_st* stream) {
  unsigned const batch = unsigned(p.grad.batch);
  differentiate_coords<<<dim3(unsigned(p.parts), batch), kThreads, 0, stream>>>(p);
  add_matrix_gradients<<<dim3(unsigned(p.chain.count), batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int composed_warp(ComposedWarp<T> const& p, CUstream_st* stream) {
  auto const& y = p.y;
  if (p.interpolation == Interpolation::nearest) {
    TileGrid const tiles(y.batch, y.height, y.width, 1);
    sample_nearest<<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
    return cudaGetLastError();
  }
  TileGrid const tiles(y.batch, y.height, y.width, tiles_per_block(y.batch, y.height, y.width));
  with_alignment_of(p.x, [&](auto aligned) {
    constexpr bool kAligned = aligned.value;
    sample_bilinear<T, kAligned>
        <<<tiles.blocks, kThreads, SourceTile<T, kAligned>::bytes(p.x.channels), stream>>>(p, tiles);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(composed_coords, ComposedCoords)
KV_INSTANTIATE_COMPUTED(composed_coords_backward, ComposedCoordsBackward)
KV_INSTANTIATE_ONE(composed_warp, ComposedWarp, float)
KV_INSTANTIATE_ONE(composed_warp, ComposedWarp, ::kv::Half)
KV_INSTANTIATE_ONE(composed_warp, ComposedWarp, ::kv::BFloat16)
KV_INSTANTIATE_ONE(composed_warp, ComposedWarp, uint8_t)

}  // namespace kv::geometry::cuda
