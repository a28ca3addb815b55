// Cross-correlation with any kernel on CUDA. Images that filter2d_strip.cu does not support, and volumes, go by tiles
// in shared memory, from which all taps read. float64 and kernels that are too large for shared memory take one thread
// for each element.
#include "core/stencils/filter_list.cuh"
#include "filter2d_tile.cuh"

namespace kv::filters::cuda {

// Launches the kernel of filter2d_strip.cu if it supports p, and returns whether it did.
template <class T>
bool try_filter2d_strips(Filter2d<T> const& p, CUstream_st* stream);
template <class T>
bool try_filter2d_strips(Filter2dList<T> const& p, CUstream_st* stream, int& error);

namespace {

// for_each_reader with a single call of f in the code: nested over axes, its inlined copies would take minutes to
// compile.
template <class F>
__device__ __forceinline__ void for_each_reader_once(Border accumulation, KernelAxis axis, int pixel, int size, F f) {
  auto const for_each = [&](auto g) {
    for_each_reader(accumulation, pixel, size, axis.size - 1 - axis.before, axis.before, g);
  };
  int count = 0;
  for_each([&](int) { ++count; });
#pragma unroll 1
  for (int i = 0; i < count; ++i) {
    int at = pixel, k = 0;
    if (i > 0) for_each([&](int position) { at = k++ == i ? position : at; });
    f(at);
  }
}

// The sums of a warp's pixels. `window` is the first pixel that is read for the first of them. A thread takes every
// 32nd pixel, so that the reads of a warp are adjacent wherever they start. The weights are in shared memory column by
// column. Along a column of the kernel the last kDown rows of the window stay in registers, row r in v[r % kDown].
__device__ __forceinline__ void correlate(float const* window, int pitch, float const* weights, int ky, int kx,
                                          float (&sums)[kDown][kAcross]) {
  for (int x = 0; x < kx; ++x, weights += ky) {
    float const* next = window + threadIdx.x % 32 + x;
    float v[kDown][kAcross];
    auto const load_row = [&](int slot) {
#pragma unroll
      for (int i = 0; i < kAcross; ++i) v[slot][i] = next[32 * i];
      next += pitch;
    };
#pragma unroll
    for (int row = 0; row < kDown - 1; ++row) load_row(row);
    for (int first = 0; first < ky; first += kDown) {
#pragma unroll
      for (int k = 0; k < kDown; ++k) {
        if (first + k >= ky) break;
        load_row((k + kDown - 1) % kDown);
        float const weight = weights[first + k];
#pragma unroll
        for (int o = 0; o < kDown; ++o)
#pragma unroll
          for (int i = 0; i < kAcross; ++i) sums[o][i] += weight * v[(o + k) % kDown][i];
      }
    }
  }
}

// The pixels of a tile along one axis that receive sums of positions out of bounds. `from` is the tile's first pixel.
struct BorderPixels {
  int low, low_count, high, high_count;

  __device__ __forceinline__ BorderPixels(Border accumulation, KernelAxis axis, int from, int tile, int size) {
    int const end = min(from + tile, size), before = axis.size - 1 - axis.before, after = axis.before;
    bool const reflects = accumulation == Border::reflect;
    low = max(from, reflects && size - 1 > after ? 1 : 0);
    low_count = max(0, min(end, reflects ? before + 1 : min(before, 1)) - low);
    high = max(low + low_count, reflects ? size - 1 - after : size - min(after, 1));
    high_count = max(0, min(end, reflects ? size - 1 : size) - high);
  }
  __device__ __forceinline__ int count() const { return low_count + high_count; }
  __device__ __forceinline__ int at(int i) const { return i < low_count ? low + i : high + i - low_count; }
};

// Calls f(tap, plane) for the taps along z of every position whose border plane is z. An image has one plane.
template <class T, class F>
__device__ __forceinline__ void for_each_plane(Filter2d<T> const& p, int z, F f) {
  for_each_reader_once(p.accumulation, p.axis_z, z, p.depth, [&](int at) {
#pragma unroll 1
    for (int k = 0; k < p.axis_z.size; ++k) {
      int const plane = border_index(p.border, at + k - p.axis_z.before, p.depth);
      if (plane >= 0) f(k, plane);
    }
  });
}

template <class T>
__device__ __forceinline__ void correlate_tile(Filter2d<T> const& p, Tiles const& tiles, unsigned block) {
  extern __shared__ __align__(16) float shared[];
  float *const tile = shared, *const all_weights = tile + tiles.rows * tiles.pitch;
  int* const sources = reinterpret_cast<int*>(all_weights + p.taps());
  float* const border_sums = reinterpret_cast<float*>(sources + tiles.rows);  // of volumes
  int64_t const down = block / tiles.across, slice = down / tiles.down, step = p.y.step;
  int64_t const plane = slice / step, channel = slice - plane * step;
  int const x0 = int(block - down * tiles.across) * kWidth, y0 = int(down - slice * tiles.down) * kHeight;
  int const width = int(p.y.width), height = int(p.y.height), z = int(plane % p.depth);
  int const kx = p.axis_x.size, ky = p.axis_y.size;
  bool const is_volume = p.axis_z.size > 1, accumulates = p.accumulation != Border::constant;

  float const* const kernel = p.kernel_of(plane);
  for (int i = threadIdx.x; i < p.taps(); i += kThreads) {
    int const in_plane = i % (kx * ky), tap = i - in_plane + in_plane % ky * kx + in_plane / ky;
    all_weights[i] = kernel[p.flip ? p.taps() - 1 - tap : tap];
  }

  // The pixels near the border are computed again, with the sums of positions out of bounds. Corners are computed
  // twice, with the same result.
  int const columns_of_tile = min(kWidth, width - x0), rows_of_tile = min(kHeight, height - y0);
  BorderPixels const rows(p.accumulation, p.axis_y, y0, kHeight, height),
      columns(p.accumulation, p.axis_x, x0, kWidth, width);
  int const in_rows = rows.count() * columns_of_tile,
            border_pixels = accumulates ? in_rows + columns.count() * rows_of_tile : 0;
  auto const for_each_border_pixel = [&](auto f) {
#pragma unroll 1
    for (int i = threadIdx.x; i < border_pixels; i += kThreads) {
      bool const in_row = i < in_rows;
      int const k = in_row ? i : i - in_rows, line = k / (in_row ? columns_of_tile : rows_of_tile),
                along = k - line * (in_row ? columns_of_tile : rows_of_tile);
      f(i, in_row ? x0 + along : columns.at(line), in_row ? rows.at(line) : y0 + along);
    }
  };
  if (is_volume) for_each_border_pixel([&](int i, int, int) { border_sums[i] = 0; });

  int const lane = threadIdx.x % 32, row = threadIdx.x / 32 * kDown;
  float const* const window = tile + tiles.lead - p.axis_x.before;
  auto const border_sum = [&](float const* weights, int x, int y) {
    float sum = 0;
    for_each_reader_once(p.accumulation, p.axis_y, y, height, [&](int at_y) {
      int const first_y = at_y - p.axis_y.before, from_y = max(0, -first_y), to_y = min(ky, height - first_y);
      for_each_reader_once(p.accumulation, p.axis_x, x, width, [&](int at_x) {
        int const first_x = at_x - p.axis_x.before, from_x = max(0, -first_x), to_x = min(kx, width - first_x);
        for (int j = from_x; j < to_x; ++j)
          for (int i = from_y; i < to_y; ++i)
            sum += weights[j * ky + i] * window[(at_y + i - y0) * tiles.pitch + at_x + j - x0];
      });
    });
    return sum;
  };

  float sums[kDown][kAcross] = {};
  for_each_plane(p, z, [&](int kz, int from_z) {
    load_tile(tile, sources, tiles, p.x, plane - z + from_z, channel, p.border, x0, y0 - p.axis_y.before);
    float const* const weights = all_weights + kz * kx * ky;
    correlate(window + row * tiles.pitch, tiles.pitch, weights, ky, kx, sums);
    if (is_volume) for_each_border_pixel([&](int i, int x, int y) { border_sums[i] += border_sum(weights, x, y); });
  });
  bool const clamps = sizeof(T) > 1 && p.clamps;
#pragma unroll
  for (int o = 0; o < kDown; ++o) {
    if (y0 + row + o >= height) break;
    T* const out = p.y.row(plane, y0 + row + o) + channel;
#pragma unroll
    for (int i = 0; i < kAcross; ++i) {
      int const x = x0 + 32 * i + lane;
      if (x < width) out[x * step] = round_to<T>(clamps ? p.clamped(sums[o][i]) : sums[o][i]);
    }
  }
  if (!accumulates) return;
  __syncthreads();
  for_each_border_pixel([&](int i, int x, int y) {
    float const sum = is_volume ? border_sums[i] : border_sum(all_weights, x, y);
    p.y.row(plane, y)[x * step + channel] = round_to<T>(sum);
  });
}

template <class T>
__global__ void __launch_bounds__(kThreads, 5)
    filter_tile(__grid_constant__ Filter2d<T> const p, __grid_constant__ Tiles const tiles) {
  correlate_tile(p, tiles, blockIdx.x);
}
template <class T>
__global__ void __launch_bounds__(kThreads, 5)
    filter_tile_of_list(__grid_constant__ Filter2dList<T> const list, __grid_constant__ Tiles const tiles) {
  unsigned block;
  Filter2d<T> const* const p = sample_of_block(list, block);
  if (p) correlate_tile(*p, tiles.of(p->y), block);
}

template <class T>
int launch_tiles(Filter2dList<T> const& p, Tiles const& tiles, int64_t bytes, CUstream_st* stream) {
  if (int const error =
          cudaFuncSetAttribute(filter_tile_of_list<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch_list(
      p,
      [](Filter2d<T> const& one) {
        return one.y.count() * one.y.step * ceil_div(one.y.width, kWidth) * ceil_div(one.y.height, kHeight);
      },
      [&](Filter2dList<T> const& list, unsigned blocks) {
        filter_tile_of_list<T><<<blocks, kThreads, bytes, stream>>>(list, tiles);
      });
}

template <class T>
int launch_tiles(Filter2d<T> const& p, Tiles const& tiles, int64_t bytes, CUstream_st* stream) {
  int64_t const blocks = p.y.count() * p.y.step * tiles.across * tiles.down;
  if (int const error = cudaFuncSetAttribute(filter_tile<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  filter_tile<<<unsigned(blocks), kThreads, bytes, stream>>>(p, tiles);
  return cudaGetLastError();
}

// One thread for each element.
template <class T>
__device__ __forceinline__ void correlate_any(Filter2d<T> const& p, unsigned block) {
  using F = Compute<T>;
  int64_t const index = int64_t(block) * blockDim.x + threadIdx.x, size = p.y.row_size(), step = p.y.step;
  if (index >= p.y.rows() * size) return;
  int64_t const row = index / size, e = index - row * size, plane = row / p.y.height, channel = e % step;
  int const x = int(e / step), y = int(row - plane * p.y.height), z = int(plane % p.depth);
  KernelAxis const axis_x = p.axis_x, axis_y = p.axis_y, axis_z = p.axis_z;
  F const* const kernel = p.kernel_of(plane);
  F sum = 0;
  // Calls f(tap, pixel) for the taps along one axis of every position whose border pixel is i.
  auto const for_taps = [&](KernelAxis axis, int i, int64_t results, int64_t pixels, auto f) {
    for_each_reader_once(p.accumulation, axis, i, int(results), [&](int at) {
#pragma unroll 1
      for (int k = 0; k < axis.size; ++k) {
        int const pixel = border_index(p.border, at + k - axis.before, int(pixels));
        if (pixel >= 0) f(p.flip ? axis.size - 1 - k : k, pixel);
      }
    });
  };
  for_taps(axis_z, z, p.depth, p.depth, [&](int kz, int from_z) {
    for_taps(axis_y, y, p.y.height, p.x.height, [&](int ky, int from_y) {
      T const* const from = p.x.row(plane - z + from_z, from_y) + channel;
      F const* const weights = kernel + (kz * axis_y.size + ky) * axis_x.size;
      for_taps(axis_x, x, p.y.width, p.x.width,
               [&](int kx, int from_x) { sum += weights[kx] * read(from[from_x * step]); });
    });
  });
  p.y.row(plane, y)[e] = round_to<T>(sizeof(T) > 1 && p.clamps ? p.clamped(sum) : sum);
}

template <class T>
__global__ void filter_any(__grid_constant__ Filter2d<T> const p) {
  correlate_any(p, blockIdx.x);
}
template <class T>
__global__ void filter_any_of_list(__grid_constant__ Filter2dList<T> const list) {
  unsigned block;
  Filter2d<T> const* const p = sample_of_block(list, block);
  if (p) correlate_any(*p, block);
}

// By tiles, if these serve a filter `p` of images like x and y. `work`: p or a list of such.
template <class T, class Work>
bool try_tiles(Filter2d<T> const& p, Work const& work, CUstream_st* stream, int& error) {
  if constexpr (!__is_same(T, double)) {
    // The border is accumulated within a tile: it must hold all pixels that a border pixel needs.
    bool const accumulates = p.accumulation != Border::constant;
    auto const after = [&](KernelAxis axis) { return max(axis.size - 1 - axis.before, accumulates ? axis.before : 0); };
    auto const reach = [&](KernelAxis axis) { return axis.before + after(axis); };
    bool const fits_tile = !accumulates || (reach(p.axis_x) < 2 * kWidth && reach(p.axis_y) < 2 * kHeight);
    Tiles const tiles(p.x, p.y, p.axis_x.before, after(p.axis_x), reach(p.axis_y));
    auto const border_lines = [&](KernelAxis axis) { return axis.size + 1; };
    int64_t const border_sums = p.axis_z.size > 1 && accumulates ? min(border_lines(p.axis_y), kHeight) * kWidth +
                                                                       min(border_lines(p.axis_x), kWidth) * kHeight
                                                                 : 0,
                  bytes = tiles.bytes(p.taps() + border_sums);
    // Special case, H200: 12 (filter2d_11x11 backward) to 24 (filter2d_11x11) times as fast as a thread an element.
    if (!fits_tile || bytes > max_shared_bytes(kMaxSharedBytes)) return false;
    error = launch_tiles(work, tiles, bytes, stream);
    return true;
  }
  return false;
}

}  // namespace

template <class T>
int filter2d(Filter2d<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double))
    if (try_filter2d_strips(p, stream)) return cudaGetLastError();
  if (int error; try_tiles(p, p, stream, error)) return error;
  filter_any<<<unsigned(ceil_div(p.y.rows() * p.y.row_size(), 256)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int filter2d_list(Filter2dList<T> const& p, CUstream_st* stream) {
  int error = 0;
  if constexpr (!__is_same(T, double))
    if (try_filter2d_strips(p, stream, error)) return error;
  if (try_tiles(p.sample(0), p, stream, error)) return error;
  return launch_list(
      p, [](Filter2d<T> const& one) { return ceil_div(one.y.rows() * one.y.row_size(), 256); },
      [&](Filter2dList<T> const& list, unsigned blocks) { filter_any_of_list<T><<<blocks, 256, 0, stream>>>(list); });
}

KV_INSTANTIATE_WITH_BYTES(filter2d, Filter2d)
KV_INSTANTIATE_WITH_BYTES(filter2d_list, Filter2dList)

}  // namespace kv::filters::cuda
