// Cross-correlation with any kernel on CUDA. Images that filter2d_strip.cu does not serve go by tiles in shared memory,
// with every tap of a kernel from there; 3x3 and 5x5 kernels are in registers. Volumes, float64 and kernels that shared
// memory has no room for take one thread an element.
#include <cuda_pipeline.h>

#include "core/launch.cuh"
#include "filter2d.h"

namespace kv::cuda {

// Launches the kernel of filter2d_strip.cu if it serves p, and says so.
template <class T>
bool filter2d_strips(Filter2d<T> const& p, CUstream_st* stream);

namespace {

constexpr int kWidth = 128, kHeight = 32;  // of a tile, in pixels computed
constexpr int kWarps = 4, kThreads = 32 * kWarps;
constexpr int kDown = kHeight / kWarps, kAcross = kWidth / 32;  // pixels of a thread
constexpr int64_t kMostShared = 100 << 10;                      // bytes of a block: two of them share a multiprocessor

// The tiles of one channel of a plane, and the pixels around a tile that are read with it: from pixel -before on,
// `pitch` columns of `rows` rows.
struct Tiles {
  int across, down, pitch, rows;

  template <class T>
  Tiles(Planes<T> const& p, int columns, int rows)
      : across(int(ceil_div(p.width, kWidth))),
        down(int(ceil_div(p.height, kHeight))),
        pitch((kWidth + columns + 3) / 4 * 4),
        rows(kHeight + rows) {}
  int64_t bytes(int64_t numbers) const { return 4 * (int64_t(pitch) * rows + rows + numbers); }
};

// Fills a tile whose first pixel is (x0, y0) of a plane; `sources` has room for a number for each row.
template <class T>
__device__ __forceinline__ void load_tile(float* tile, int* sources, Tiles const& tiles, Planes<T const> const& p,
                                          int64_t plane, int64_t channel, Border border, int x0, int y0) {
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  for (int row = threadIdx.x; row < tiles.rows; row += kThreads)
    sources[row] = border_index(border, y0 + row, int(p.height));
  __syncthreads();
  T const* const in = p.plane(plane) + channel;
  for (int i = lane; i < tiles.pitch; i += 32) {
    int const column = border_index(border, x0 + i, int(p.width));
    T const* const top = in + int64_t(column) * p.step;
#pragma unroll 8
    for (int row = warp; row < tiles.rows; row += kWarps) {
      int const source = sources[row];
      bool const outside = column < 0 || source < 0;
      float* const to = tile + row * tiles.pitch + i;
      if constexpr (__is_same(T, float))
        __pipeline_memcpy_async(to, outside ? in : top + source * p.row_stride, 4, outside ? 4 : 0);
      else
        *to = outside ? 0.f : read(top[source * p.row_stride]);
    }
  }
  __pipeline_commit();
  __pipeline_wait_prior(0);
  __syncthreads();
}

// for_each_position with f in the code once: nested over axes, its copies would take minutes to compile.
template <class F>
__device__ __forceinline__ void visit_positions(Border fold, KernelAxis axis, int pixel, int size, F f) {
  auto const for_each = [&](auto g) {
    for_each_position(fold, pixel, size, axis.size - 1 - axis.before, axis.before, g);
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

// --- filtering
// ----------------------------------------------------------------------------------------------------------

// What a warp's threads sum, `window` being the first pixel that is read for the first of its pixels. Weights are in
// shared memory, column by column.
//
// Small kernels: neighbouring pixels a thread, so that a row of its window is two reads; the weights in registers.
template <int K>
__device__ __forceinline__ void correlate(float const* window, int pitch, float const* weights, int, int,
                                          float (&sums)[kDown][kAcross]) {
  static_assert(kAcross == 4 && K <= 5, "a row of the window is eight numbers");
  float w[K][K];
#pragma unroll
  for (int i = 0; i < K * K; ++i) w[i % K][i / K] = weights[i];
  float const* const first = window + kAcross * (threadIdx.x % 32);
#pragma unroll
  for (int row = 0; row < kDown + K - 1; ++row) {
    Pack<float, 8> v;
    *reinterpret_cast<float4*>(v.v) = *reinterpret_cast<float4 const*>(first + row * pitch);
    *reinterpret_cast<float4*>(v.v + 4) = *reinterpret_cast<float4 const*>(first + row * pitch + 4);
#pragma unroll
    for (int o = 0; o < kDown; ++o) {
      if (row < o || row >= o + K) continue;
#pragma unroll
      for (int kx = 0; kx < K; ++kx)
#pragma unroll
        for (int i = 0; i < kAcross; ++i) sums[o][i] += w[row - o][kx] * v.v[i + kx];
    }
  }
}

// Any kernel: every 32nd pixel a thread, so that reads of a warp are neighbours wherever they start. Going down a
// column of the kernel, the last kDown rows of the window stay in registers, row r in v[r % kDown].
template <>
__device__ __forceinline__ void correlate<0>(float const* window, int pitch, float const* weights, int ky, int kx,
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

// The pixels of one axis of a tile that receive from positions beyond the image, `from` being the tile's first pixel.
struct Rim {
  int low, low_count, high, high_count;

  __device__ __forceinline__ Rim(Border fold, KernelAxis axis, int from, int tile, int size) {
    int const end = min(from + tile, size), before = axis.size - 1 - axis.before, after = axis.before;
    bool const reflects = fold == Border::reflect;
    low = max(from, reflects && size - 1 > after ? 1 : 0);
    low_count = max(0, min(end, reflects ? before + 1 : min(before, 1)) - low);
    high = max(low + low_count, reflects ? size - 1 - after : size - min(after, 1));
    high_count = max(0, min(end, reflects ? size - 1 : size) - high);
  }
  __device__ __forceinline__ int count() const { return low_count + high_count; }
  __device__ __forceinline__ int at(int i) const { return i < low_count ? low + i : high + i - low_count; }
};

template <class T, int K>
__global__ void __launch_bounds__(kThreads, 5)
    filter_tile(__grid_constant__ Filter2d<T> const p, __grid_constant__ Tiles const tiles, bool packed) {
  extern __shared__ __align__(16) float shared[];
  float *const tile = shared, *const weights = tile + tiles.rows * tiles.pitch;
  int* const sources = reinterpret_cast<int*>(weights + p.taps());
  int64_t const down = blockIdx.x / tiles.across, slice = down / tiles.down, step = p.y.step;
  int64_t const plane = slice / step, channel = slice - plane * step;
  int const x0 = int(blockIdx.x - down * tiles.across) * kWidth, y0 = int(down - slice * tiles.down) * kHeight;
  int const width = int(p.y.width), height = int(p.y.height), kx = p.axis_x.size, ky = p.axis_y.size;

  float const* const kernel = p.kernel_of(plane);
  for (int i = threadIdx.x; i < kx * ky; i += kThreads) {
    int const tap = i % ky * kx + i / ky;
    weights[i] = kernel[p.flip ? kx * ky - 1 - tap : tap];
  }
  load_tile(tile, sources, tiles, p.x, plane, channel, p.border, x0 - p.axis_x.before, y0 - p.axis_y.before);

  int const lane = threadIdx.x % 32, row = threadIdx.x / 32 * kDown;
  float sums[kDown][kAcross] = {};
  correlate<K>(tile + row * tiles.pitch, tiles.pitch, weights, ky, kx, sums);
  Strip<0, true, kAcross> const pack(x0 + kAcross * lane, width, Border::constant);
#pragma unroll
  for (int o = 0; o < kDown; ++o) {
    if (y0 + row + o >= height) break;
    T* const out = p.y.row(plane, y0 + row + o) + channel;
    if (K > 0 && packed) {
      pack.store(out, sums[o]);
    } else {
#pragma unroll
      for (int i = 0; i < kAcross; ++i) {
        int const x = x0 + (K > 0 ? kAcross * lane + i : 32 * i + lane);
        if (x < width) out[x * step] = round_to<T>(sums[o][i]);
      }
    }
  }
  if (p.fold == Border::constant) return;

  // The rim again, now with what its other positions receive; corners twice, with the same result.
  __syncthreads();
  auto const fold_pixel = [&](int x, int y) {
    float sum = 0;
    visit_positions(p.fold, p.axis_y, y, height, [&](int at_y) {
      int const first_y = at_y - p.axis_y.before, from_y = max(0, -first_y), to_y = min(ky, height - first_y);
      visit_positions(p.fold, p.axis_x, x, width, [&](int at_x) {
        int const first_x = at_x - p.axis_x.before, from_x = max(0, -first_x), to_x = min(kx, width - first_x);
        for (int j = from_x; j < to_x; ++j)
          for (int i = from_y; i < to_y; ++i)
            sum += weights[j * ky + i] * tile[(at_y + i - y0) * tiles.pitch + at_x + j - x0];
      });
    });
    p.y.row(plane, y)[x * step + channel] = round_to<T>(sum);
  };
  int const wide = min(kWidth, width - x0), high = min(kHeight, height - y0);
  Rim const rows(p.fold, p.axis_y, y0, kHeight, height), columns(p.fold, p.axis_x, x0, kWidth, width);
  int const in_rows = rows.count() * wide, pixels = in_rows + columns.count() * high;
#pragma unroll 1
  for (int i = threadIdx.x; i < pixels; i += kThreads) {
    bool const in_row = i < in_rows;
    int const k = in_row ? i : i - in_rows, line = k / (in_row ? wide : high),
              along = k - line * (in_row ? wide : high);
    fold_pixel(in_row ? x0 + along : columns.at(line), in_row ? rows.at(line) : y0 + along);
  }
}

template <int K, class T>
int launch_tiles(Filter2d<T> const& p, Tiles const& tiles, CUstream_st* stream) {
  int64_t const bytes = tiles.bytes(p.taps()), blocks = p.y.count() * p.y.step * tiles.across * tiles.down;
  if (int const error =
          cudaFuncSetAttribute(filter_tile<T, K>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  filter_tile<T, K><<<unsigned(blocks), kThreads, bytes, stream>>>(p, tiles, is_strip<kAcross>(p.y));
  return cudaGetLastError();
}

// One thread an element.
template <class T>
__global__ void filter_any(__grid_constant__ Filter2d<T> const p) {
  using F = Compute<T>;
  int64_t const index = int64_t(blockIdx.x) * blockDim.x + threadIdx.x, size = p.y.row_size(), step = p.y.step;
  if (index >= p.y.rows() * size) return;
  int64_t const row = index / size, e = index - row * size, plane = row / p.y.height, channel = e % step;
  int const x = int(e / step), y = int(row - plane * p.y.height), z = int(plane % p.depth);
  KernelAxis const axis_x = p.axis_x, axis_y = p.axis_y, axis_z = p.axis_z;
  F const* const kernel = p.kernel_of(plane);
  F sum = 0;
  // Calls f(tap, pixel) for the taps along one axis at every position at which pixel i stands.
  auto const for_taps = [&](KernelAxis axis, int i, int64_t results, int64_t pixels, auto f) {
    visit_positions(p.fold, axis, i, int(results), [&](int at) {
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
  p.y.row(plane, y)[e] = round_to<T>(sum);
}

// --- the gradient to the kernel
// ----------------------------------------------------------------------------------------

// Sums each of eight numbers over the threads of a warp; thread i receives sum i % 8.
__device__ __forceinline__ float warp_sums(float (&v)[8]) {
#pragma unroll
  for (int n = 4; n > 0; n /= 2) {
    bool const upper = threadIdx.x & n;
#pragma unroll
    for (int i = 0; i < n; ++i) {
      float const give = upper ? v[i] : v[i + n];
      v[i] = (upper ? v[i + n] : v[i]) + __shfl_xor_sync(0xffffffffu, give, n);
    }
  }
  float sum = v[0] + __shfl_xor_sync(0xffffffffu, v[0], 8);
  return sum + __shfl_xor_sync(0xffffffffu, sum, 16);
}

// One block a part, tile by tile of the gradient, whose pixels are in registers. Below them the rows of the image pass:
// each meets N rows of the kernel at once.
template <class T, int N>
__global__ void __launch_bounds__(kThreads, 3)
    taps_tile(__grid_constant__ Filter2dTaps<T> const p, __grid_constant__ Tiles const tiles) {
  extern __shared__ __align__(16) float shared[];
  int const kx = p.axis_x.size, ky = p.axis_y.size, taps = kx * ky, lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  float *const tile = shared, *const sums = tile + tiles.rows * tiles.pitch, *const own_sums = sums + warp * taps;
  int* const sources = reinterpret_cast<int*>(sums + kWarps * taps);
  for (int i = threadIdx.x; i < kWarps * taps; i += kThreads) sums[i] = 0;

  int64_t const part = blockIdx.x, plane = part / p.parts_down(), first = (part - plane * p.parts_down()) * p.part_rows;
  int const last = int(min(first + p.part_rows, p.grad.height)), width = int(p.grad.width);
  int const step = int(p.grad.step), columns = step * tiles.across;
  for (int y0 = int(first); y0 < last; y0 += kHeight) {
    for (int i = 0; i < columns; ++i) {
      int const x0 = i / step * kWidth, channel = i % step, y = y0 + warp * kDown;
      float g[kDown][kAcross];
#pragma unroll
      for (int o = 0; o < kDown; ++o)
#pragma unroll
        for (int c = 0; c < kAcross; ++c) {
          int const x = x0 + 32 * c + lane;
          g[o][c] = y + o < last && x < width ? read(p.grad.row(plane, y + o)[int64_t(x) * step + channel]) : 0.f;
        }
      __syncthreads();  // the tile before this one is done with
      load_tile(tile, sources, tiles, p.x, plane, channel, p.border, x0 - p.axis_x.before, y0 - p.axis_y.before);

      auto const add = [&](auto whole) {
        for (int first_tap = 0; first_tap < ky; first_tap += N)
          for (int x = 0; x < kx; ++x) {
            float const* row = tile + (warp * kDown + first_tap) * tiles.pitch + lane + x;
            float products[8] = {};
#pragma unroll
            for (int r = 0; r < kDown + N - 1; ++r, row += tiles.pitch)
#pragma unroll
              for (int c = 0; c < kAcross; ++c) {
                float const v = row[32 * c];
#pragma unroll
                for (int k = 0; k < N; ++k) {
                  int const o = r - k;
                  if (o < 0 || o >= kDown) continue;
                  // Outside of the gradient not even NaN counts.
                  bool const inside = decltype(whole)::value || (y + o < last && x0 + 32 * c + lane < width);
                  products[k] += inside ? g[o][c] * v : 0.f;
                }
              }
            float const sum = warp_sums(products);
            if (lane < N && first_tap + lane < ky) own_sums[(first_tap + lane) * kx + x] += sum;
          }
      };
      if (y0 + kHeight <= last && x0 + kWidth <= width)
        add(std::true_type{});
      else
        add(std::false_type{});
    }
  }
  __syncthreads();
  for (int i = threadIdx.x; i < taps; i += kThreads)
    p.parts[part * taps + i] = (sums[i] + sums[taps + i]) + (sums[2 * taps + i] + sums[3 * taps + i]);
}

template <int N, class T>
int launch_taps(Filter2dTaps<T> const& p, Tiles const& tiles, CUstream_st* stream) {
  int64_t const bytes = tiles.bytes(kWarps * p.taps());
  if (int const error = cudaFuncSetAttribute(taps_tile<T, N>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  taps_tile<T, N><<<unsigned(p.count()), kThreads, bytes, stream>>>(p, tiles);
  return cudaGetLastError();
}

constexpr int kTapsTogether = 8;  // of a thread, which then reads the gradient once for all of them

// Any size and type: one block a part and group of taps.
template <class T>
__global__ void __launch_bounds__(256) taps_any(__grid_constant__ Filter2dTaps<T> const p, int groups) {
  using F = Compute<T>;
  int64_t const part = blockIdx.x / groups;
  int const first_tap = int(blockIdx.x - part * groups) * kTapsTogether, taps = p.taps();
  int64_t const plane = part / p.parts_down(), first = (part - plane * p.parts_down()) * p.part_rows;
  int64_t const size = p.grad.row_size(), step = p.x.step, count = min(p.part_rows, p.grad.height - first) * size;
  int const z = int(plane % p.depth);
  F sums[kTapsTogether] = {};
  for (int64_t i = threadIdx.x; i < count; i += 256) {
    int64_t const row = i / size, e = i - row * size, x = e / step, channel = e - x * step;
    F const g = read(p.grad.row(plane, first + row)[e]);
#pragma unroll
    for (int t = 0; t < kTapsTogether; ++t) {
      int const tap = first_tap + t, line = tap / p.axis_x.size;
      if (tap >= taps) break;
      int const kx = tap % p.axis_x.size, ky = line % p.axis_y.size, kz = line / p.axis_y.size;
      int const from_x = border_index(p.border, int(x) + kx - p.axis_x.before, int(p.x.width)),
                from_y = border_index(p.border, int(first + row) + ky - p.axis_y.before, int(p.x.height)),
                from_z = border_index(p.border, z + kz - p.axis_z.before, p.depth);
      if (from_x >= 0 && from_y >= 0 && from_z >= 0)
        sums[t] += g * read(p.x.row(plane - z + from_z, from_y)[from_x * step + channel]);
    }
  }
  __shared__ F of_warps[kTapsTogether][8];
#pragma unroll
  for (int t = 0; t < kTapsTogether; ++t) {
    for (int lane = 16; lane > 0; lane /= 2) sums[t] += __shfl_xor_sync(0xffffffffu, sums[t], lane);
    if (threadIdx.x % 32 == 0) of_warps[t][threadIdx.x / 32] = sums[t];
  }
  __syncthreads();
  if (threadIdx.x < kTapsTogether && first_tap + int(threadIdx.x) < taps) {
    F sum = 0;
    for (int warp = 0; warp < 8; ++warp) sum += of_warps[threadIdx.x][warp];
    p.parts[part * taps + first_tap + threadIdx.x] = sum;
  }
}

// One warp a sum.
template <class F>
__global__ void sum_of_parts(SumParts<F> p) {
  int64_t const i = int64_t(blockIdx.x) * 8 + threadIdx.x / 32;
  if (i >= p.count) return;
  F const* const terms = p.terms + i / p.size * p.parts * p.size + i % p.size;
  double sum = 0;
  for (int64_t part = threadIdx.x % 32; part < p.parts; part += 32) sum += terms[part * p.size];
  for (int lane = 16; lane > 0; lane /= 2) sum += __shfl_xor_sync(0xffffffffu, sum, lane);
  if (threadIdx.x % 32 == 0) p.sums[i] = F(sum);
}

}  // namespace

template <class T>
int filter2d(Filter2d<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double)) {
    if (filter2d_strips(p, stream)) return cudaGetLastError();
    // A pixel of the rim is folded from the tile that it is in.
    bool const folds = p.fold != Border::constant;
    auto const beside = [&](KernelAxis axis) {
      int const after = axis.size - 1 - axis.before;
      return axis.before + (folds ? max(axis.before, after) : after);
    };
    bool const foldable = !folds || (beside(p.axis_x) < 2 * kWidth && beside(p.axis_y) < 2 * kHeight);
    Tiles const tiles(p.y, beside(p.axis_x), beside(p.axis_y));
    if (p.axis_z.size == 1 && foldable && tiles.bytes(p.taps()) <= kMostShared) {
      if (p.axis_x.size == 3 && p.axis_y.size == 3) return launch_tiles<3>(p, tiles, stream);
      if (p.axis_x.size == 5 && p.axis_y.size == 5) return launch_tiles<5>(p, tiles, stream);
      return launch_tiles<0>(p, tiles, stream);
    }
  }
  filter_any<<<unsigned(ceil_div(p.y.rows() * p.y.row_size(), 256)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int filter2d_taps(Filter2dTaps<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double)) {
    int const together = p.axis_y.size <= 5 ? 5 : 8;  // rows of the kernel; the image's below the last one are not used
    Tiles const tiles(p.grad, p.axis_x.size - 1, int(ceil_div(p.axis_y.size, together)) * together - 1);
    if (p.axis_z.size == 1 && tiles.bytes(kWarps * p.taps()) <= kMostShared)
      return together == 5 ? launch_taps<5>(p, tiles, stream) : launch_taps<8>(p, tiles, stream);
  }
  int const groups = int(ceil_div(p.taps(), kTapsTogether));
  taps_any<<<unsigned(p.count() * groups), 256, 0, stream>>>(p, groups);
  return cudaGetLastError();
}

template <class F>
int sum_parts(SumParts<F> const& p, CUstream_st* stream) {
  sum_of_parts<<<unsigned(ceil_div(p.count, 8)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(filter2d, Filter2d)
KV_INSTANTIATE(filter2d_taps, Filter2dTaps)
KV_INSTANTIATE_ONE(sum_parts, SumParts, float)
KV_INSTANTIATE_ONE(sum_parts, SumParts, double)

}  // namespace kv::cuda
