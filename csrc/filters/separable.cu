// Separable filters on CUDA: a kernel for any layout, type and size, a kernel for windows of any size over planar
// images, and the gradient to the weights. Small windows go to the strip kernel of separable_strip.cuh.
#include "separable_strip.cuh"

namespace kv::filters::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int64_t kMaxSharedBytes = 200 << 10;  // of a block that we ask for at most

template <class F>
__device__ __forceinline__ void load_weights(Taps<F> const& taps, int64_t sample, F scale, F* weights) {
  for (int t = threadIdx.x; t < taps.size; t += blockDim.x) weights[t] = tap_weight(taps, sample, t);
  __syncthreads();
  F sum = 0;
  if (taps.gaussian)
    for (int t = 0; t < taps.size; ++t) sum += weights[t];
  __syncthreads();
  if (taps.gaussian) scale /= sum;
  for (int t = threadIdx.x; t < taps.size; t += blockDim.x) weights[t] *= scale;
  __syncthreads();
}

// A kernel's dynamic shared memory as an array of F.
template <class F>
__device__ __forceinline__ F* shared_memory() {
  extern __shared__ __align__(16) unsigned char bytes[];
  return reinterpret_cast<F*>(bytes);
}

// --- any layout: one thread goes down one column of elements ---------------------------------------------------------

// A ring in shared memory holds the rows within `reach` of the one computed, filtered along x: the row of a position is
// at the position modulo the ring's size.
template <class T>
__device__ __forceinline__ void filter_any(Separable<T> const& p, unsigned block, int rows, int reach) {
  using F = Compute<T>;
  F *const kx = shared_memory<F>(), *const ky = kx + p.kx.size, *const ring = ky + p.ky.size;
  int const width = int(p.y.width), height = int(p.y.height), in_width = int(p.x.width), in_height = int(p.x.height);
  int64_t const step = p.y.step, across = (p.y.row_size() + blockDim.x - 1) / blockDim.x;
  int64_t const down = (height + rows - 1) / rows, tile_row = block / across, plane = tile_row / down;
  int const y0 = int(tile_row - plane * down) * rows, y1 = min(y0 + rows, height);
  load_weights(p.kx, plane / p.planes, F(1), kx);
  load_weights(p.ky, plane / p.planes, p.alpha_of(plane), ky);

  int64_t const e = (block - tile_row * across) * blockDim.x + threadIdx.x;
  if (e >= p.y.row_size()) return;
  int const column = int(e / step);
  int64_t const channel = e - column * step;
  int const ring_rows = 2 * reach + 1;
  auto const at = [&](int position) -> F& {
    return ring[(position + ring_rows) % ring_rows * blockDim.x + threadIdx.x];
  };
  for (int position = y0 - reach; position < y1 + reach; ++position) {
    F along_x = 0;
    int const source = border_index(p.border, position, in_height);
    if (source >= 0) {
      T const* const row = p.x.row(plane, source) + channel;
      for_each_reader(p.accumulation, column, width, p.kx.front(), p.kx.back(), [&](int q) {
        int const left = q - p.kx.before;
        if (left >= 0 && left + p.kx.size <= in_width) {
          T const* const first = row + left * step;
#pragma unroll 8
          for (int t = 0; t < p.kx.size; ++t) along_x += kx[t] * read(first[t * step]);
          return;
        }
#pragma unroll 1
        for (int t = 0; t < p.kx.size; ++t) {
          int const x = border_index(p.border, left + t, in_width);
          if (x >= 0) along_x += kx[t] * read(row[x * step]);
        }
      });
    }
    at(position) = along_x;
    int const y = position - reach;
    if (y < y0) continue;
    F sum = 0;
    for_each_reader(p.accumulation, y, height, p.ky.front(), p.ky.back(), [&](int q) {
      // The window's rows up to the end of the ring, then those from its beginning.
      int const top = q - p.ky.before, first = max(top, y - reach), last = min(top + p.ky.size, y + reach + 1);
      int t = first - top;
      for (int from = first; from < last;) {
        F const* slot = &at(from);
        int const end = t + min(last - from, ring_rows - (from + ring_rows) % ring_rows);
        from += end - t;
#pragma unroll 8
        for (; t < end; ++t, slot += blockDim.x) sum += ky[t] * *slot;
      }
    });
    if (p.beta != 0) sum += p.beta * read(p.x.row(plane, y)[e]);
    p.y.row(plane, y)[e] = round_to<T>(sum);
  }
}

template <class T>
__global__ void separable_any(Separable<T> const p, int rows, int reach) {
  filter_any(p, blockIdx.x, rows, reach);
}
template <class F>
KV_HD int reach_of(Taps<F> const& ky) {
  return max(ky.before, ky.size - 1 - ky.before);
}
template <class T>
__global__ void separable_any_of_list(__grid_constant__ SeparableList<T> const list, int rows) {
  unsigned block;
  Separable<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  filter_any(*p, block, rows, reach_of(p->ky));
}

// How blocks go down the columns of images: their reach, threads and shared memory.
template <class T>
struct AnyBlocks {
  int reach, threads, bytes;

  explicit AnyBlocks(Separable<T> const& p) : reach(reach_of(p.ky)), threads(kThreads), bytes(bytes_of(p)) {
    while (threads > 8 && bytes > max_shared_bytes(kMaxSharedBytes)) threads /= 2, bytes = bytes_of(p);
  }
  int bytes_of(Separable<T> const& p) const {
    return int(sizeof(Compute<T>)) * (p.kx.size + p.ky.size + (2 * reach + 1) * threads);
  }
  int64_t columns(Separable<T> const& p) const { return p.y.count() * ceil_div(p.y.row_size(), threads); }
};

template <class T>
int launch_any(Separable<T> const& p, CUstream_st* stream) {
  AnyBlocks<T> const plan(p);
  if (int error = cudaFuncSetAttribute(separable_any<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, plan.bytes))
    return error;
  int const rows = strip_height(plan.columns(p), p.y.height, max(p.ky.size, 8), 1024, 1024);
  int64_t const blocks = plan.columns(p) * ceil_div(p.y.height, rows);
  separable_any<<<unsigned(blocks), plan.threads, plan.bytes, stream>>>(p, rows, plan.reach);
  return cudaGetLastError();
}
template <class T>
int launch_any(SeparableList<T> const& p, CUstream_st* stream) {
  AnyBlocks<T> const plan(p.all);
  if (int error =
          cudaFuncSetAttribute(separable_any_of_list<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, plan.bytes))
    return error;
  auto const columns_of = [&](Separable<T> const& one) { return plan.columns(one); };
  int const rows = strip_height(sum_of_samples(p, columns_of), largest_height(p), max(p.all.ky.size, 8), 1024, 1024);
  return launch_list(
      p, [&](Separable<T> const& one) { return plan.columns(one) * ceil_div(one.y.height, rows); },
      [&](SeparableList<T> const& list, unsigned blocks) {
        separable_any_of_list<T><<<blocks, plan.threads, plan.bytes, stream>>>(list, rows);
      });
}

// --- planar images and windows of any size: a block goes down 128 columns of pixels ----------------------------------

constexpr int kTileWidth = 128, kTileHeight = 64;  // pixels computed at a time, 4 x 8 by a thread
constexpr int kTileThreads = 256;
constexpr int kPitch = kTileWidth + 4;  // of rows filtered along x: eight adjacent rows lie in different banks

// N sums over windows that begin at 0 ... N - 1, of C adjacent channels of numbers each: the last N numbers are in
// registers.
template <int N, int C, class Load>
__device__ __forceinline__ void filter_windows(float const* weights, int taps, Load load, float (&sums)[N][C]) {
  float v[N][C];
#pragma unroll
  for (int i = 0; i < N - 1; ++i) load(i, v[i]);
#pragma unroll 1
  for (int first = 0; first < taps; first += N)
#pragma unroll
    for (int i = 0; i < N; ++i) {
      if (first + i >= taps) break;
      load(first + i + N - 1, v[(i + N - 1) % N]);
      float const weight = weights[first + i];
#pragma unroll
      for (int n = 0; n < N; ++n)
#pragma unroll
        for (int c = 0; c < C; ++c) sums[n][c] = fmaf(weight, v[(i + n) % N][c], sums[n][c]);
    }
}

// Shared memory of a block: the pixels of 32 rows, the rows filtered along x that windows along y need, and the
// weights.
struct TileMemory {
  int across, pitch, rows;  // pixels read of a row; their pitch, odd: a column lies in different banks; filtered rows
  int kx, ky;
  template <class F>
  KV_HD TileMemory(Taps<F> const& x, Taps<F> const& y)
      : across(kTileWidth + x.size - 1), pitch(across | 1), rows(kTileHeight + y.size - 1), kx(x.size), ky(y.size) {}
  int numbers() const { return rows * kPitch + 32 * pitch + across + kx + ky; }
};

// Those of small Gaussians have the bits that strips give them.
__device__ __forceinline__ void load_tile_weights(Taps<float> const& taps, int64_t sample, float scale,
                                                  float* weights) {
  if (!taps.gaussian || taps.size > 32) return load_weights(taps, sample, scale, weights);
  if (threadIdx.x < 32) {
    float const weight = weight_of_lane(taps, sample, int(threadIdx.x));
    if (int(threadIdx.x) < taps.size) weights[threadIdx.x] = scale * weight;
  }
  __syncthreads();
}

// reflect_backward: the transpose of a reflected border, as in separable_strip.cuh: border pixels count doubled.
template <class T>
__device__ __forceinline__ void filter_tiles(Separable<T> const& p, unsigned block, TileMemory const& memory, int rows,
                                             bool reflect_backward, bool aligned) {
  float *const filtered = shared_memory<float>(), *const pixels = filtered + memory.rows * kPitch;
  float *const kx = pixels + 32 * memory.pitch, *const ky = kx + memory.kx;
  int* const columns = reinterpret_cast<int*>(ky + memory.ky);
  int const width = int(p.y.width), height = int(p.y.height), in_width = int(p.x.width), in_height = int(p.x.height);
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  unsigned const across = unsigned(width + kTileWidth - 1) / kTileWidth, down = unsigned(height + rows - 1) / rows;
  unsigned const tile_row = block / across, plane = tile_row / down;
  int const x0 = int(block - tile_row * across) * kTileWidth, y0 = int(tile_row - plane * down) * rows;
  int const y1 = min(y0 + rows, height), overlap = memory.ky - 1;
  for (int i = threadIdx.x; i < memory.across; i += kTileThreads)
    columns[i] =
        i < min(kTileWidth, width - x0) + memory.kx - 1 ? border_index(p.border, x0 - p.kx.before + i, in_width) : -1;
  load_tile_weights(p.kx, int64_t(plane) / p.planes, 1.f, kx);
  load_tile_weights(p.ky, int64_t(plane) / p.planes, p.alpha_of(plane), ky);
  auto const is_end = [](int i, int n) { return i == 0 || i == n - 1; };

  for (int y = y0; y < y1; y += kTileHeight) {
    int const has = y == y0 ? 0 : overlap, needs = min(kTileHeight, y1 - y) + overlap;
    for (int row = has; row < needs; row += 32) {
      // A warp loads four rows, then filters 16 columns; each of its threads filters one of the 32 rows.
      int const first = row + 4 * warp;
      T const* from[4];
      bool exists[4], doubled[4];
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        int const source = first + i < needs ? border_index(p.border, y - p.ky.before + first + i, in_height) : -1;
        exists[i] = source >= 0;
        doubled[i] = reflect_backward && is_end(source, in_height);
        from[i] = p.x.row(plane, max(source, 0));
      }
#pragma unroll 2
      for (int column = lane; column < memory.across; column += 32) {
        int const source = columns[column];
        float const scale = reflect_backward && is_end(source, in_width) ? 2.f : 1.f;
#pragma unroll
        for (int i = 0; i < 4; ++i) {
          float const pixel = exists[i] && source >= 0 ? read(from[i][source]) : 0.f;
          pixels[(4 * warp + i) * memory.pitch + column] =
              reflect_backward ? pixel * (doubled[i] ? 2 * scale : scale) : pixel;
        }
      }
      __syncthreads();
      float sums[16][1] = {};
      float const* const window = pixels + lane * memory.pitch + 16 * warp;
      filter_windows(kx, memory.kx, [&](int i, float(&v)[1]) { v[0] = window[i]; }, sums);
      if (row + lane < needs) {
#pragma unroll
        for (int i = 0; i < 16; i += 4)
          *reinterpret_cast<float4*>(filtered + (row + lane) * kPitch + 16 * warp + i) =
              float4{sums[i][0], sums[i + 1][0], sums[i + 2][0], sums[i + 3][0]};
      }
      __syncthreads();
    }

    float sums[8][4] = {};
    float const* const window = filtered + 8 * warp * kPitch + 4 * lane;
    if (y + 8 * warp < y1)
      filter_windows(
          ky, memory.ky,
          [&](int i, float(&v)[4]) {
            float4 const four = *reinterpret_cast<float4 const*>(window + i * kPitch);
            v[0] = four.x, v[1] = four.y, v[2] = four.z, v[3] = four.w;
          },
          sums);
    int const x = x0 + 4 * lane;
#pragma unroll
    for (int n = 0; n < 8; ++n) {
      int const at = y + 8 * warp + n;
      if (at >= y1) break;
#pragma unroll
      for (int c = 0; c < 4; ++c) {
        if (reflect_backward) sums[n][c] *= (is_end(at, height) ? 0.5f : 1.f) * (is_end(x + c, width) ? 0.5f : 1.f);
        if (p.beta != 0 && x + c < width) sums[n][c] += p.beta * read(p.x.row(plane, at)[x + c]);
      }
      store_pixels(p.y.row(plane, at) + x, sums[n], x, width, aligned);
    }
    // The last rows are the first of the next tile.
    for (int row = 0; row < overlap; row += kTileHeight) {
      __syncthreads();
      for (int i = threadIdx.x; i < min(kTileHeight, overlap - row) * kPitch / 4; i += kTileThreads)
        reinterpret_cast<float4*>(filtered + row * kPitch)[i] =
            reinterpret_cast<float4 const*>(filtered + (row + kTileHeight) * kPitch)[i];
    }
    __syncthreads();
  }
}

template <class T>
__global__ void __launch_bounds__(kTileThreads, 2)
    separable_tiles(__grid_constant__ Separable<T> const p, TileMemory memory, int rows, bool reflect_backward,
                    bool aligned) {
  filter_tiles(p, blockIdx.x, memory, rows, reflect_backward, aligned);
}
template <class T>
__global__ void __launch_bounds__(kTileThreads, 2)
    separable_tiles_of_list(__grid_constant__ SeparableList<T> const list, int rows, bool reflect_backward) {
  unsigned block;
  Separable<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  filter_tiles(*p, block, TileMemory(p->kx, p->ky), rows, reflect_backward, false);
}

int resident_blocks_of_tiles(int bytes) {
  return multiprocessors() * (bytes > max_shared_bytes(kMaxSharedBytes) / 2 ? 1 : 2);
}

template <class T>
int launch_tiles(SeparableList<T> p, bool reflect_backward, CUstream_st* stream) {
  int const bytes = 4 * TileMemory(p.all.kx, p.all.ky).numbers(), resident = resident_blocks_of_tiles(bytes);
  if (int error = cudaFuncSetAttribute(separable_tiles_of_list<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  if (reflect_backward) p.all.border = Border::reflect;
  auto const columns_of = [](Separable<T> const& one) { return one.y.count() * ceil_div(one.y.width, kTileWidth); };
  int const rows =
      strip_height(sum_of_samples(p, columns_of), largest_height(p), max(p.all.ky.size, 8), resident, resident);
  return launch_list(
      p, [&](Separable<T> const& one) { return columns_of(one) * ceil_div(one.y.height, rows); },
      [&](SeparableList<T> const& list, unsigned blocks) {
        separable_tiles_of_list<T><<<blocks, kTileThreads, bytes, stream>>>(list, rows, reflect_backward);
      });
}

template <class T>
int launch_tiles(Separable<T> p, bool reflect_backward, CUstream_st* stream) {
  TileMemory const memory(p.kx, p.ky);
  int const bytes = 4 * memory.numbers(), resident = resident_blocks_of_tiles(bytes);
  if (int error = cudaFuncSetAttribute(separable_tiles<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  if (reflect_backward) p.border = Border::reflect;
  int64_t const tile_columns = p.y.count() * ceil_div(p.y.width, kTileWidth);
  int const rows = strip_height(tile_columns, p.y.height, max(p.ky.size, 8), resident, resident);
  separable_tiles<<<unsigned(tile_columns * ceil_div(p.y.height, rows)), kTileThreads, bytes, stream>>>(
      p, memory, rows, reflect_backward, is_vectorizable<4>(p.y));
  return cudaGetLastError();
}

// --- the gradient to the weights -------------------------------------------------------------------------------------

static_assert(kWeightsTileWidth == kThreads);

// A block goes down the positions that its tile reads. With g = 0 out of the tile and gv(q, c) the sum over i of
// ky[i] g(q + before_y - i, c),
//
//   dkx[j] = sum over q, c of gv(q, c) x(q, c - before_x + j)      dky[i] = sum over q, c of g(q + before_y - i, c)
//   h(q, c)
//
// so each position needs one row of x in shared memory and the last rows of g, of which each thread has one column.
// A warp sums for one weight; its threads hold the partial sums.
template <class T>
__global__ void __launch_bounds__(kThreads) weights_backward_tiles(SeparableWeightsBackward<T> const p) {
  using F = Compute<T>;
  constexpr int kStride = kThreads + 1;  // of the rows of g: a column lies in different banks
  int const taps_x = p.kx.size, taps_y = p.ky.size, taps = taps_x + taps_y, thread = threadIdx.x, lane = thread % 32;
  F *const kx = shared_memory<F>(), *const ky = kx + taps_x, *const x = ky + taps_y, *const h = x + kThreads + taps_x;
  F *const gv = h + kThreads, *const g = gv + kThreads, *const sums = g + taps_y * kStride;
  int64_t const tile = blockIdx.x, across = p.across(), tile_row = tile / across, plane = tile_row / p.down();
  int64_t const x0 = (tile - tile_row * across) * kThreads, column = x0 + thread;
  int const y0 = int((tile_row - plane * p.down()) * p.tile_height), y1 = int(min(y0 + p.tile_height, p.grad.height));
  bool const in_bounds = column < p.grad.width;
  load_weights(p.kx, plane / p.planes, F(1), kx);
  load_weights(p.ky, plane / p.planes, F(1), ky);
  for (int i = thread; i < 32 * taps; i += kThreads) sums[i] = 0;
  for (int i = 0; i < taps_y; ++i) g[i * kStride + thread] = 0;

  int newest = 0;  // slot of row q + before_y of g; the rows above it precede it
  auto const row_of_g = [&](int i) { return g + (newest >= i ? newest - i : newest - i + taps_y) * kStride; };
  for (int q = y0 - p.ky.before; q < y1 - p.ky.before + taps_y - 1; ++q) {
    newest = newest + 1 < taps_y ? newest + 1 : 0;
    int const y = q + p.ky.before;
    int64_t const source = border_index(p.border, int64_t(q), p.x.height);
    g[newest * kStride + thread] = y < y1 && in_bounds ? read(p.grad.row(plane, y)[column]) : F(0);
    for (int i = thread; i < kThreads + taps_x - 1; i += kThreads) {
      int64_t const at = border_index(p.border, x0 - p.kx.before + i, p.x.width);
      x[i] = source >= 0 && at >= 0 ? read(p.x.row(plane, source)[at]) : F(0);
    }
    __syncthreads();
    F along_x = 0, along_y = 0;
    for (int j = 0; j < taps_x; ++j) along_x += kx[j] * x[thread + j];
    for (int i = 0; i < taps_y; ++i) along_y += ky[i] * row_of_g(i)[thread];
    h[thread] = in_bounds ? along_x : F(0);
    gv[thread] = along_y;
    __syncthreads();
    for (int t = thread / 32; t < taps; t += kThreads / 32) {
      F const* const a = t < taps_x ? gv : h;
      F const* const b = t < taps_x ? x + t : row_of_g(t - taps_x);
      F sum = 0;
      for (int i = lane; i < kThreads; i += 32) sum += a[i] * b[i];
      sums[32 * t + lane] += sum;
    }
    __syncthreads();
  }
  for (int t = thread / 32; t < taps; t += kThreads / 32) {
    F const sum = warp_reduce(sums[32 * t + lane], Sum());
    if (lane == 0) p.sums[tile * taps + t] = sum;
  }
}

}  // namespace

template <class T>
int separable(Separable<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double)) {
    bool const symmetric = p.kx.gaussian && p.ky.gaussian;
    // Special case, H200: 1.21 (canny) to 6.3 (unsharp5) times as fast as tiles.
    if (supports_strips(p.x, p.ky.size, p.kx.size)) {
      if (p.accumulation == Border::constant) return separable_strips(p, 1, stream);
      if constexpr (sizeof(T) > 1)
        // Special case, H200: 1.02 (canny backward) to 2.4 (gauss31 backward) times as fast as the transpose of any
        // border.
        return p.accumulation == Border::reflect && symmetric ? separable_reflect_backward_strips(p, 1, stream)
                                                              : separable_backward_strips(p, stream);
    }
    bool const reflect_backward = p.accumulation == Border::reflect && symmetric;
    if (p.x.step == 1 && p.y.step == 1 && (p.accumulation == Border::constant || reflect_backward) &&
        // Special case, H200: 8.6 (gauss33) to 12 (gauss33 backward) times as fast as a thread an element.
        4 * TileMemory(p.kx, p.ky).numbers() <= max_shared_bytes(kMaxSharedBytes))
      return launch_tiles(p, reflect_backward, stream);
  }
  return launch_any(p, stream);
}

// Transposes of borders that are accumulated have no strips, but those of reflected borders.
template <class T>
int separable_list(SeparableList<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double)) {
    Separable<T> const& all = p.all;
    bool const reflect_backward =
        all.accumulation == Border::reflect && all.kx.gaussian && all.ky.gaussian && sizeof(T) > 1;
    if (all.accumulation == Border::constant || reflect_backward) {
      auto const fits_strips = [](Separable<T> const& one) { return supports_strips(one.x, one.ky.size, one.kx.size); };
      if (!all.by_sides.is_used && all_samples(p, fits_strips)) {
        if constexpr (sizeof(T) > 1)
          if (reflect_backward) return separable_reflect_backward_strips(p, 1, stream);
        return separable_strips(p, 1, stream);
      }
      if (!p.list.interleaved && 4 * TileMemory(all.kx, all.ky).numbers() <= max_shared_bytes(kMaxSharedBytes))
        return launch_tiles(p, reflect_backward, stream);
    }
  }
  return launch_any(p, stream);
}

template <class T>
int separable_weights_backward(SeparableWeightsBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  int const taps = p.kx.size + p.ky.size;
  size_t const bytes = sizeof(F) * (taps + 3 * kThreads + p.kx.size + p.ky.size * (kThreads + 1) + 32 * taps);
  if (int error =
          cudaFuncSetAttribute(weights_backward_tiles<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  unsigned const tiles = unsigned(p.grad.count() * p.down() * p.across());
  weights_backward_tiles<<<tiles, kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(separable, Separable)
KV_INSTANTIATE_WITH_BYTES(separable_list, SeparableList)
KV_INSTANTIATE(separable_weights_backward, SeparableWeightsBackward)

}  // namespace kv::filters::cuda
