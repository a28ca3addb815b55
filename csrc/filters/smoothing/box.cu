// Window sums on CUDA. Odd square windows up to 31 x 31 are separable filters with weights of 1. For all others a block
// goes down a tile in batches of eight rows. Along rows and columns it adds prefix and suffix sums of chunks, so that
// the cost hardly depends on the window's size.
#include <cuda_pipeline.h>

#include "box.h"
#include "core/launch.cuh"
#include "filters/separable_strip.cuh"

namespace kv::filters::cuda {
namespace {

// --- windows of any size ---------------------------------------------------------------------------------------------

constexpr int kRows = 8;  // of a batch, one for each warp; and of a chunk of column sums
constexpr int kChunk =
    9;  // pixels of a chunk of row sums, one for each thread; odd, so that threads use different banks
constexpr int kBatches = 3;  // in the ring; all but one are in flight
constexpr int kSpan = 32 * kChunk;
constexpr int kPitch = kSpan + 16;  // with room to start at a multiple of 16 bytes

// A tile is `width` columns of pixels by `height` rows.
struct Tiles {
  int width, height, across, down;
  int depth;  // chunks of column sums in the ring

  template <class F>
  int64_t bytes() const {
    return (int64_t(kBatches) * kRows * kPitch + int64_t(depth) * kRows * width) * sizeof(F);
  }
  template <class T>
  KV_HD void set_counts(Box<T> const& p) {
    across = int(ceil_div(p.x.width, width)), down = int(ceil_div(p.x.height, height));
  }
};

// The tile of a block, the positions at which it sums windows, and those that they read. Where the transpose gathers,
// positions out of bounds are summed as well, and the edge pixels receive these sums.
template <class T>
struct BoxBlock {
  static constexpr int kVectorSize = 16 / sizeof(T);
  int plane, x0, x1, y0, y1;              // the tile
  int first_x, last_x, first_y, last_y;   // positions
  int left, right, top, bottom;           // what they read; `right` and `bottom` are behind it
  int origin, vector_left, vector_right;  // rows begin at `origin` in shared memory; the pixels read as vectors

  __device__ __forceinline__ BoxBlock(unsigned block, BoxAxis const& across, BoxAxis const& down, Tiles const& tiles,
                                      bool vectorized) {
    int const q = block / tiles.across, width = int(across.size), height = int(down.size);
    plane = q / tiles.down;
    x0 = (block - q * tiles.across) * tiles.width, y0 = (q - plane * tiles.down) * tiles.height;
    x1 = min(x0 + tiles.width, width), y1 = min(y0 + tiles.height, height);
    first_x = x0 == 0 && across.gathers() ? -int(across.after) : x0;
    last_x = x1 == width && across.gathers() ? width + int(across.before) : x1;
    first_y = y0 == 0 && down.gathers() ? -int(down.after) : y0;
    last_y = y1 == height && down.gathers() ? height + int(down.before) : y1;
    left = first_x - int(across.before), right = last_x + int(across.after);
    top = first_y - int(down.before), bottom = last_y + int(down.after);
    origin = left & -kVectorSize;
    vector_left = vectorized ? max(left + kVectorSize - 1, 0) & -kVectorSize : right;
    vector_right = vectorized ? max(min(right, width) & -kVectorSize, vector_left) : right;
  }
};

// Phase 1: starts the copy of row y of the image to shared memory, by one warp. Rows out of bounds are 0.
template <class T>
__device__ __forceinline__ void copy_row(BoxBlock<T> const& block, BoxAxis const& across, BoxAxis const& down, int y,
                                         T const* in, int64_t row_stride, int step, T* to) {
  int const lane = threadIdx.x % 32, at = y < block.bottom ? border_index(down.border, y, int(down.size)) : -1;
  T const* const from = in + at * row_stride;
  auto const element = [&](int x) {
    int const column = at < 0 ? -1 : border_index(across.border, x, int(across.size));
    if (column < 0)
      to[x] = T{};
    else if constexpr (sizeof(T) >= 4)
      __pipeline_memcpy_async(to + x, from + column * step, sizeof(T));
    else  // too small for an asynchronous copy
      to[x] = from[column * step];
  };
  if (at < 0) {
    for (int x = block.left + lane; x < block.right; x += 32) to[x] = T{};
  } else {
    for (int x = block.vector_left + lane * block.kVectorSize; x < block.vector_right; x += 32 * block.kVectorSize)
      __pipeline_memcpy_async(to + x, from + x, 16);
    for (int x = block.left + lane; x < block.vector_left; x += 32) element(x);
    for (int x = block.vector_right + lane; x < block.right; x += 32) element(x);
  }
  __pipeline_commit();
}

// Phase 2: the sums along a row, in place, by one warp. v: the chunk of the thread. A window begins in one chunk and
// ends in another: its sum is that of the end of the first chunk, of the whole chunks between them, and of the
// beginning of the last chunk.
template <class T, class F>
__device__ __forceinline__ void sum_row(BoxBlock<T> const& block, int kx, int width, F (&v)[kChunk], F* row) {
  int const lane = threadIdx.x % 32;
  F* const chunk = row + lane * kChunk;
  F head = 0;
#pragma unroll
  for (int i = 0; i < kChunk; ++i) chunk[i] = head = kx > kChunk ? head + v[i] : v[i];
  __syncwarp();
  if (kx > kChunk) {
    int const whole = (kx - 1) / kChunk, past = (kx - 1) % kChunk, limit = kPitch - lane * kChunk - 1;
#pragma unroll
    for (int i = kChunk - 1; i > 0; --i) v[i - 1] += v[i];
    F middle = 0;
    for (int m = 1; m < whole; ++m) middle += chunk[min((m + 1) * kChunk - 1, limit)];
    F const longer = middle + chunk[min((whole + 1) * kChunk - 1, limit)];
#pragma unroll
    for (int i = 0; i < kChunk; ++i) v[i] += (i + past >= kChunk ? longer : middle) + chunk[min(i + kx - 1, limit)];
  } else {
#pragma unroll
    for (int i = 0; i < kChunk; ++i)
      for (int t = 1; t < kx; ++t) v[i] += chunk[i + t];
  }
  __syncwarp();
#pragma unroll
  for (int i = 0; i < kChunk; ++i) chunk[i] = v[i];
  auto const gather = [&](int from, int to, int pixel) {
    __syncwarp();
    F s = 0;
    for (int i = from + lane; i < to; i += 32) s += row[i - block.first_x];
    s = warp_reduce(s, Sum());
    __syncwarp();
    if (lane == 0) row[pixel - block.first_x] = s;
  };
  if (block.first_x < block.x0) gather(block.first_x, width == 1 ? block.last_x : 1, 0);
  if (block.last_x > block.x1 && (width > 1 || block.first_x == block.x0)) gather(width - 1, block.last_x, width - 1);
}

// Phase 3: the sums along a column that a batch completes, by one thread. h: the batch; tail: the ring of chunks.
template <class F>
__device__ __forceinline__ void sum_column(Tiles const& tiles, int ky, F (&h)[kRows], F* tail, int& oldest) {
  int const block = kRows * tiles.width;
  if (ky > kRows) {
    int const past = tiles.depth * kRows - (ky - 1), next = oldest + 1 == tiles.depth ? 0 : oldest + 1;
    F longer = 0, middle = 0;
    for (int m = 1, at = next; m < tiles.depth; ++m, at = at + 1 == tiles.depth ? 0 : at + 1)
      (m == 1 ? longer : middle) += tail[at * block];
    longer += middle;
    F below[kRows], after = 0;
#pragma unroll
    for (int j = kRows - 1; j >= 0; --j) below[j] = after += h[j];
    F before = 0;
#pragma unroll
    for (int j = 0; j < kRows; ++j) {
      bool const over = j + past >= kRows;
      before += h[j];
      h[j] =
          tail[(over ? next : oldest) * block + (j + past) % kRows * tiles.width] + (over ? middle : longer) + before;
    }
#pragma unroll
    for (int j = 0; j < kRows; ++j) tail[oldest * block + j * tiles.width] = below[j];
    oldest = next;
  } else {  // pixel by pixel, from this chunk and the one before it
#pragma unroll
    for (int j = 0; j < kRows; ++j) tail[oldest * block + j * tiles.width] = h[j];
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      for (int t = 1; t < ky; ++t)
        h[j] += tail[(t <= j ? oldest : 1 - oldest) * block + (j - t + kRows) % kRows * tiles.width];
    oldest = 1 - oldest;
  }
}

template <class T>
__device__ __forceinline__ void sum_tile(Box<T> const& p, unsigned block_of_sample, BoxAxis const& across,
                                         BoxAxis const& down, Tiles const& tiles, bool vectorized) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char memory[];
  F* const rows = reinterpret_cast<F*>(memory);       // [batch][row][element]
  F* const tails = rows + kBatches * kRows * kPitch;  // [block][row][column]
  int const warp = threadIdx.x / 32, lane = threadIdx.x % 32;
  BoxBlock<T> const block(block_of_sample, across, down, tiles, vectorized);
  int const width = int(across.size), height = int(down.size), step = int(p.x.step);
  int const kx = int(across.count()), ky = int(down.count()), top = block.top;
  T const* const in = p.x.plane(block.plane / step) + block.plane % step;
  T* const out = p.y.plane(block.plane / step) + block.plane % step;
  auto const row_of = [&](int batch) { return rows + (batch % kBatches * kRows + warp) * kPitch; };
  auto const copy = [&](int batch) {
    copy_row(block, across, down, top + batch * kRows + warp, in, p.x.row_stride, step,
             reinterpret_cast<T*>(row_of(batch)) - block.origin);
  };

  unsigned doubled_pixels = 0;  // a bit for each of the thread's pixels along the row: whether it counts twice
  if (across.doubled)
#pragma unroll
    for (int i = 0; i < kChunk; ++i) {
      int const at = border_index(across.border, block.left + lane * kChunk + i, width);
      if (at == 0 || at == width - 1) doubled_pixels |= 1u << i;
    }
  int const column = threadIdx.x, x = block.x0 + column;
  F const column_scale = across.doubled && (x == 0 || x == width - 1) ? F(0.5) : F(1);
  F const reciprocal = 1 / p.divisor;
  F* const tail = tails + column;
  F carry = 0;     // the sums of rows out of bounds that the next edge row receives
  int oldest = 0;  // chunk of column sums

#pragma unroll
  for (int i = 0; i + 1 < kBatches; ++i) copy(i);
  for (int batch = 0; top + batch * kRows < block.bottom; ++batch) {
    __pipeline_wait_prior(kBatches - 2);
    __syncwarp();
    F* const row = row_of(batch);
    F v[kChunk];
#pragma unroll
    for (int i = 0; i < kChunk; ++i)
      v[i] = read(reinterpret_cast<T const*>(row)[block.left - block.origin + lane * kChunk + i]);
    if (across.doubled || down.doubled) {
      int const y = border_index(down.border, top + batch * kRows + warp, height);
      F const weight = down.doubled && (y == 0 || y == height - 1) ? F(2) : F(1);
#pragma unroll
      for (int i = 0; i < kChunk; ++i) v[i] *= doubled_pixels >> i & 1 ? 2 * weight : weight;
    }
    __syncwarp();
    sum_row(block, kx, width, v, row);
    __syncthreads();
    copy(batch + kBatches - 1);
    if (x >= block.x1) continue;

    F const* const sums = rows + batch % kBatches * kRows * kPitch + x - block.first_x;
    F h[kRows];
#pragma unroll
    for (int j = 0; j < kRows; ++j) h[j] = sums[j * kPitch];
    sum_column(tiles, ky, h, tail, oldest);
    // Phase 4: the results.
#pragma unroll
    for (int j = 0; j < kRows; ++j) {
      int const y = top + batch * kRows + j - (ky - 1) + int(down.before);
      if (y < block.first_y || y >= block.last_y) continue;
      F total = h[j] + carry;
      bool const more = y < 0 || (y >= height - 1 && y + 1 < block.last_y);
      carry = more ? total : F(0);
      if (more) continue;
      int const at = min(y, height - 1);
      if (across.doubled || down.doubled)
        total *= down.doubled && (at == 0 || at == height - 1) ? column_scale / 2 : column_scale;
      if (p.center != 0) total += read(in[at * p.x.row_stride + x * step]) * p.center;
      out[at * p.y.row_stride + x * step] = round_to<T>(quotient<T>(total, p.divisor, reciprocal));
    }
  }
}

template <class T>
__global__ void __launch_bounds__(256, sizeof(Compute<T>) == 8 ? 1 : 3)
    box_tile(Box<T> p, BoxAxis across, BoxAxis down, Tiles tiles, bool vectorized) {
  sum_tile(p, blockIdx.x, across, down, tiles, vectorized);
}
template <class T>
__global__ void __launch_bounds__(256, sizeof(Compute<T>) == 8 ? 1 : 3)
    box_tile_of_list(__grid_constant__ BoxList<T> const list, Tiles tiles, bool transposed) {
  unsigned block;
  Box<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  tiles.set_counts(*p);
  BoxAxis const across(p->kx, p->x.width, p->border, transposed), down(p->ky, p->x.height, p->border, transposed);
  sum_tile(*p, block, across, down, tiles, false);
}

// --- windows that are too large for tiles, and transposes of even windows with a reflected border --------------------

template <class T>
__device__ __forceinline__ void sum_any(Box<T> const& p, unsigned block, bool transposed) {
  using F = Compute<T>;
  int64_t const i = int64_t(block) * blockDim.x + threadIdx.x, size = p.x.row_size(), step = p.x.step;
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height, y = r % p.x.height, x = e / step, c = e % step;
  BoxAxis const across(p.kx, p.x.width, p.border, transposed), down(p.ky, p.x.height, p.border, transposed);
  // Calls f(pixel, count) for the pixels that the window of pixel j reads; transposed, for those whose windows read j.
  auto const for_each = [&](BoxAxis const& axis, int64_t j, auto f) {
    for (int64_t q = j - axis.before; q <= j + max(axis.before, axis.after); ++q) {
      if (!transposed || axis.edge == 0) {
        int64_t const at = q <= j + axis.after ? border_index(axis.border, q, axis.size) : -1;
        if (at >= 0) f(at, F(1));
      } else if (q >= 0 && q < axis.size) {
        int64_t const times = read_count(p.border, q, j, axis.size, axis.after, axis.before);
        if (times > 0) f(q, F(times));
      }
    }
  };
  F sum = 0;
  for_each(down, y, [&](int64_t at_y, F times_y) {
    T const* const row = p.x.row(plane, at_y);
    F s = 0;
    for_each(across, x, [&](int64_t at_x, F times_x) { s += times_x * read(row[at_x * step + c]); });
    sum += times_y * s;
  });
  if (p.center != 0) sum += read(p.x.row(plane, y)[e]) * p.center;
  p.y.row(plane, y)[e] = round_to<T>(quotient<T>(sum, p.divisor, 1 / p.divisor));
}

template <class T>
__global__ void box_any(Box<T> p, bool transposed) {
  sum_any(p, blockIdx.x, transposed);
}
template <class T>
__global__ void box_any_of_list(__grid_constant__ BoxList<T> const list, bool transposed) {
  unsigned block;
  Box<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  sum_any(*p, block, transposed);
}

// --- launchers -------------------------------------------------------------------------------------------------------

// The window as a separable filter with weights of 1.
template <class T>
Separable<T> as_separable(Box<T> const& p, BoxAxis const& axis) {
  Taps<float> const ones{nullptr, 0, 0, int(p.kx), int(p.kx / 2), false, false};
  return {p.x, p.y, ones, ones, p.x.count(), 1, p.center, axis.border, Border::constant};
}

// Work: a batch or a list.
template <class T, class Work>
int launch_strips(Work const& sums, BoxAxis const& axis, Compute<T> divisor, CUstream_st* stream) {
  if constexpr (sizeof(T) > 1)
    if (axis.doubled) return separable_reflect_backward_strips(sums, divisor, stream);
  return separable_strips(sums, divisor, stream);
}

// The widest tiles that fit; of width 0 where none does.
template <class F>
Tiles widest_tiles(int64_t ky, int64_t extra_columns) {
  // Shared memory of a block: at most, and so that a multiprocessor has two.
  int64_t const max_bytes = max_shared_bytes(224 << 10), preferred = min(int64_t(112 << 10), max_bytes);
  Tiles tiles{};
  tiles.depth = ky > kRows ? int(ceil_div(ky - 1, kRows)) : 2;
  auto const fits = [&](int64_t shared) { return tiles.width + extra_columns <= kSpan && tiles.bytes<F>() <= shared; };
  for (tiles.width = 256; tiles.width > 32 && !fits(preferred);) tiles.width -= 32;
  if (!fits(max_bytes)) tiles.width = 0;
  return tiles;
}

template <class T>
int launch(Box<T> const& p, bool transposed, CUstream_st* stream) {
  using F = Compute<T>;
  BoxAxis const across(p.kx, p.x.width, p.border, transposed), down(p.ky, p.x.height, p.border, transposed);
  bool const gathers = across.gathers() || down.gathers();

  if constexpr (sizeof(T) == 1)
    if (!transposed && box_of_bytes(p, stream)) return cudaGetLastError();
  if constexpr (sizeof(T) <= 4)
    // Special case, H200: 0.91 (box31 backward) to 5.6 (box5) times as fast as the tiles below.
    if (!gathers && supports_strips(p.x, p.ky, p.kx))
      return launch_strips<T>(as_separable(p, across), across, p.divisor, stream);

  bool const even_reflect = gathers && p.border == Border::reflect;
  int64_t const planes = p.x.count() * p.x.step, extra_columns = p.kx - 1 + (across.gathers() ? p.kx - 1 : 0);
  Tiles tiles = widest_tiles<F>(p.ky, extra_columns);
  // Special case, H200: 338 (box33) to 503 (box33 backward) times as fast as a thread an element.
  if (even_reflect || tiles.width == 0) {
    box_any<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), 256)), 256, 0, stream>>>(p, transposed);
    return cudaGetLastError();
  }
  tiles.across = int(ceil_div(p.x.width, tiles.width));
  tiles.width = int(ceil_div(p.x.width, tiles.across));
  // Enough tiles for all multiprocessors, but not so low that most of their rows are those above, which are summed
  // again.
  int64_t const target = ceil_div(3 * 132, planes * tiles.across), most = ceil_div(p.x.height, max(p.ky, int64_t(32)));
  tiles.height = int(ceil_div(p.x.height, clamp(target, int64_t(1), most)));
  tiles.set_counts(p);
  int64_t const bytes = tiles.bytes<F>();
  if (int const error = cudaFuncSetAttribute(box_tile<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  box_tile<<<unsigned(planes * tiles.across * tiles.down), 256, unsigned(bytes), stream>>>(
      p, across, down, tiles, is_vectorizable<16 / sizeof(T)>(p.x));
  return cudaGetLastError();
}

template <class T>
int launch(BoxList<T> const& p, bool transposed, CUstream_st* stream) {
  using F = Compute<T>;
  Box<T> const& all = p.all;
  // The rules of the axes do not depend on the sizes of images.
  BoxAxis const across(all.kx, 1, all.border, transposed), down(all.ky, 1, all.border, transposed);
  bool const gathers = across.gathers() || down.gathers();
  if constexpr (sizeof(T) <= 4)
    if (!gathers && all_samples(p, [](Box<T> const& one) { return supports_strips(one.x, one.ky, one.kx); })) {
      SeparableList<T> sums;
      sums.all = as_separable(all, across);
      sums.all.planes = p.channels;
      sums.list = p.list, sums.chosen = p.chosen, sums.chosen_stride = p.chosen_stride, sums.channels = p.channels;
      return launch_strips<T>(sums, across, all.divisor, stream);
    }
  Tiles tiles = widest_tiles<F>(all.ky, all.kx - 1 + (across.gathers() ? all.kx - 1 : 0));
  if ((gathers && all.border == Border::reflect) || tiles.width == 0)
    return launch_list(
        p, [](Box<T> const& one) { return ceil_div(one.x.rows() * one.x.row_size(), 256); },
        [&](BoxList<T> const& list, unsigned blocks) {
          box_any_of_list<T><<<blocks, 256, 0, stream>>>(list, transposed);
        });
  tiles.height = int(max(all.ky, int64_t(64)));
  int64_t const bytes = tiles.bytes<F>();
  if (int const error =
          cudaFuncSetAttribute(box_tile_of_list<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch_list(
      p,
      [&](Box<T> const& one) {
        Tiles own = tiles;
        own.set_counts(one);
        return one.x.count() * one.x.step * own.across * own.down;
      },
      [&](BoxList<T> const& list, unsigned blocks) {
        box_tile_of_list<T><<<blocks, 256, unsigned(bytes), stream>>>(list, tiles, transposed);
      });
}

}  // namespace

template <class T>
int box(Box<T> const& p, CUstream_st* stream) {
  return launch(p, false, stream);
}
template <class T>
int box_backward(Box<T> const& p, CUstream_st* stream) {
  return launch(p, true, stream);
}

template <class T>
int box_list(BoxList<T> const& p, CUstream_st* stream) {
  return launch(p, false, stream);
}
template <class T>
int box_list_backward(BoxList<T> const& p, CUstream_st* stream) {
  return launch(p, true, stream);
}

KV_INSTANTIATE_WITH_BYTES(box_list, BoxList)
KV_INSTANTIATE(box_list_backward, BoxList)
KV_INSTANTIATE_WITH_BYTES(box, Box)
KV_INSTANTIATE(box_backward, Box)

}  // namespace kv::filters::cuda
