// CLAHE on CUDA. The first launch builds the tables, one block per tile. The second one maps the pixels: a block
// takes some columns of a row of cells, and interleaves the four tables of each cell in shared memory, four bytes per
// entry.
#include "byte_histogram.cuh"
#include "clahe.h"

namespace kv::enhance::cuda {
namespace {

// Traverses a rectangle of width x height pixels in vectors of P neighbors. load(x, y) reads a vector; at(x) returns a
// function that is called with (y, vector) for the vectors of one column, and its state stays in the thread.
template <int Threads, int P, class Load, class At>
__device__ __forceinline__ void for_each_vector(int width, int height, Load load, At at) {
  constexpr int kAtOnce = 4;
  for (int first = 0; first < width; first += Threads * P) {
    int const across = min((width - first) / P, Threads), rows = Threads / across;
    int y = int(threadIdx.x) / across;
    int const x = first + (int(threadIdx.x) - y * across) * P;
    if (y >= rows) continue;
    auto const f = at(x);
    for (; y < height; y += rows * kAtOnce) {
      decltype(load(x, y)) vectors[kAtOnce];
#pragma unroll
      for (int i = 0; i < kAtOnce; ++i)
        if (y + i * rows < height) vectors[i] = load(x, y + i * rows);
#pragma unroll
      for (int i = 0; i < kAtOnce; ++i)
        if (y + i * rows < height) f(y + i * rows, vectors[i]);
    }
  }
}

// Whether pixels [begin, end) of a row consist of whole aligned vectors.
template <int P>
__device__ __forceinline__ bool rows_are_aligned(bool aligned, int begin, int end) {
  return aligned && begin % P == 0 && end % P == 0;
}

template <class T, int Threads>
__global__ void __launch_bounds__(Threads) make_tables(Clahe<T> p, bool aligned) {
  using F = Compute<T>;
  using Counter = LevelCounter<Threads / 32>;
  constexpr int kEach = Threads < kLevels ? kLevels / Threads : 1;  // levels per thread
  __shared__ __align__(16) int32_t counts[Counter::kSize];
  Counter const counter{counts};
  unsigned const tiles = unsigned(p.down.count * p.across.count), plane = blockIdx.x / tiles;
  int const tile = int(blockIdx.x - plane * tiles), ty = tile / p.across.count, tx = tile - ty * p.across.count;
  T const* const image = p.x.plane(plane);
  counter.template clear<Threads>();
  __syncthreads();
  int const x0 = tx * p.across.size, y0 = ty * p.down.size, x1 = x0 + p.across.size, y1 = y0 + p.down.size;
  auto const add = [&](auto&& load) {
    constexpr int P = sizeof(load(0, 0).v) / sizeof(T);
    for_each_vector<Threads, P>(p.across.size, p.down.size, load, [&](int) {
      return [&](int, Vector<T, P> const& vector) {
#pragma unroll
        for (T const pixel : vector.v) counter.add(level_of(pixel));
      };
    });
  };
  if (x1 <= p.across.pixels && y1 <= p.down.pixels && rows_are_aligned<kPixels<T>>(aligned, x0, x1))
    add([&](int x, int y) {
      return *reinterpret_cast<Vector<T, kPixels<T>> const*>(image + (y0 + y) * p.x.row_stride + x0 + x);
    });
  else
    add([&](int x, int y) {
      return Vector<T, 1>{image[p.down.reflected(y0 + y) * p.x.row_stride + p.across.reflected(x0 + x) * p.x.step]};
    });
  __syncthreads();

  int const first = int(threadIdx.x) * kEach;
  int count[kEach], above = 0, total;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    int const all = first + i < kLevels ? counter[first + i] : 0;
    count[i] = min(all, p.limit);
    above += all - count[i];
  }
  block_inclusive_scan<Threads>(above, total);
  Excess const spread(total);
  int own = 0;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    if (first + i < kLevels) count[i] += spread.of(first + i);
    own += count[i];
  }
  int sum = block_inclusive_scan<Threads>(own, total) - own;
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);
  uint8_t* const table = p.tables + int64_t(blockIdx.x) * kLevels;
  Vector<uint8_t, kEach> levels;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    sum += count[i];
    levels.v[i] = uint8_t(rint(min(F(sum) * scale, F(255))));
  }
  if (first < kLevels) *reinterpret_cast<Vector<uint8_t, kEach>*>(table + first) = levels;
}

constexpr int kThreads = 128;

// Byte k of four, as a floating-point number.
template <class F>
__device__ __forceinline__ F byte_of(uint32_t four, int k) {
  if constexpr (sizeof(F) == 4)  // 2^23 plus the byte, as bits: a conversion instruction takes four times as long
    return __uint_as_float(__byte_perm(four, 0x4b000000u, 0x7440 + k)) - F(1 << 23);
  else
    return F(four >> 8 * k & 255);
}
// v / 255, rounded like a float division, in a third of its instructions (P. Markstein, "Computation of elementary
// functions on the IBM RISC System/6000 processor", 1990).
__device__ __forceinline__ float over_255(float v) {
  constexpr float one = 1.f / 255;
  float const q = v * one;
  return fmaf(fmaf(-255.f, q, v), one, q);
}
__device__ __forceinline__ double over_255(double v) { return v / 255; }

// How the cells of a plane are split into blocks.
struct CellBlocks {
  int columns, cells;     // pixels of a block along x, and the most cells that they are in
  unsigned across, down;  // blocks of a row of cells, along x and along y

  // Threads have `each` adjacent columns.
  CellBlocks(TileAxis const& x, TileAxis const& y, int each) : columns(min(256, kThreads * each)) {
    auto const cells_of = [&](int pixels) { return min(x.count + 1, (pixels - 1) / x.size + 2); };
    while (columns > 32 && cells_of(columns) > 64) columns /= 2;  // memory
    cells = cells_of(columns);
    across = unsigned(ceil_div(x.pixels, columns)), down = unsigned(ceil_div(y.size, 64));
  }
  int bytes() const { return cells * kLevels * int(sizeof(uint32_t)); }
};

// A thread has P adjacent columns, whose cells and weights it keeps.
template <class T, int P>
__global__ void __launch_bounds__(kThreads) map_cells(__grid_constant__ Clahe<T> const p, CellBlocks const blocks) {
  using F = Compute<T>;
  constexpr int kAtOnce = P == 1 ? 8 : 2;
  extern __shared__ __align__(16) uint32_t tables[];  // of all cells: kLevels entries of the four bytes of a level
  unsigned const line = blockIdx.x / blocks.across, index = line / blocks.down;
  unsigned const plane = index / unsigned(p.down.count + 1);
  int const cy = int(index - plane * unsigned(p.down.count + 1)), chunk = int(line - index * blocks.down);
  int const x0 = int(blockIdx.x - line * blocks.across) * blocks.columns;
  int const x1 = min(x0 + blocks.columns, p.across.pixels);
  int const top = p.down.cell(cy), rows = p.down.cell(cy + 1) - top;
  int const y0 = top + int(int64_t(rows) * chunk / blocks.down),
            y1 = top + int(int64_t(rows) * (chunk + 1) / blocks.down);
  if (y0 >= y1) return;

  int const threads_across = blocks.columns / P, below = int(threadIdx.x) / threads_across;
  int const x = x0 + (int(threadIdx.x) - below * threads_across) * P, step = kThreads / threads_across;
  int start = x < x1 ? y0 + below : y1;
  T const* const from = p.x.plane(plane) + x * p.x.step;
  T* const to = p.y.plane(plane) + x * p.y.step;
  Vector<T, P> vectors[kAtOnce];
  auto const fetch = [&](int i, int y) {
    if (y < y1) vectors[i] = *reinterpret_cast<Vector<T, P> const*>(from + y * p.x.row_stride);
  };
#pragma unroll
  for (int i = 0; i < kAtOnce; ++i) fetch(i, start + i * step);

  uint8_t const* const of_tiles = p.tables + int64_t(plane) * p.down.count * p.across.count * kLevels;
  auto const word = [&](int ty, int tx, int i) {  // levels 4 i to 4 i + 3
    return reinterpret_cast<uint32_t const*>(of_tiles + (ty * p.across.count + tx) * kLevels)[i];
  };
  int const first = p.across.cell_of(x0), end = p.across.cell_of(x1 - 1) + 1;
  for (int e = int(threadIdx.x); e < (end - first) * (kLevels / 4); e += kThreads) {
    int const cx = first + e / (kLevels / 4), i = e % (kLevels / 4);
    uint32_t const a = word(p.down.before(cy), p.across.before(cx), i),
                   b = word(p.down.before(cy), p.across.after(cx), i),
                   c = word(p.down.after(cy), p.across.before(cx), i),
                   d = word(p.down.after(cy), p.across.after(cx), i);
    Vector<uint32_t, 4> entries;
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      unsigned const pick = k | (k + 4) << 4;  // byte k of both words
      entries.v[k] = __byte_perm(__byte_perm(a, b, pick), __byte_perm(c, d, pick), 0x5410);
    }
    *reinterpret_cast<Vector<uint32_t, 4>*>(tables + 4 * e) = entries;
  }
  uint32_t const* table[P];
  F across[P];
#pragma unroll
  for (int k = 0; k < P; ++k) {
    int const cx = p.across.cell_of(x + k);
    table[k] = tables + (cx - first) * kLevels;
    across[k] = p.across.template weight<F>(x + k, cx);
  }
  __syncthreads();

#pragma unroll 1
  for (; start < y1; start += kAtOnce * step) {
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i) {
      int const y = start + i * step;
      if (y >= y1) break;
      Vector<T, P> const pixels = vectors[i];
      fetch(i, y + kAtOnce * step);
      F const down = p.down.template weight<F>(y, cy);
      F v[P];
#pragma unroll
      for (int k = 0; k < P; ++k) {
        int const level = level_of(pixels.v[k]);
        uint32_t const four = table[k][level & (kLevels - 1)];
        v[k] =
            mixed(byte_of<F>(four, 0), byte_of<F>(four, 1), byte_of<F>(four, 2), byte_of<F>(four, 3), across[k], down);
        F const mapped = over_255(p.to_levels ? rint(v[k]) : v[k]);
        v[k] = level < kLevels ? mapped : read(pixels.v[k]);
      }
      store_vector(to + y * p.y.row_stride, v);
    }
  }
}

}  // namespace

template <class T>
int clahe(Clahe<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count(), tile = int64_t(p.down.size) * p.across.size;
  unsigned const tiles = unsigned(planes * p.down.count * p.across.count);
  bool const aligned = is_vectorizable<kPixels<T>>(p.x) && is_vectorizable<kPixels<T>>(p.y);
  if (tile <= 8192)
    make_tables<T, 64><<<tiles, 64, 0, stream>>>(p, aligned);
  else
    make_tables<T, 512><<<tiles, 512, 0, stream>>>(p, aligned);
  int error = 0;
  with_row_vectors<kRowVector<T>>(aligned, [&](auto pixels) {
    auto* const kernel = map_cells<T, pixels.value>;
    CellBlocks const blocks(p.across, p.down, pixels.value);
    error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, blocks.bytes());
    if (!error)
      kernel<<<unsigned(planes * (p.down.count + 1)) * blocks.down * blocks.across, kThreads, blocks.bytes(), stream>>>(
          p, blocks);
  });
  return error ? error : int(cudaGetLastError());
}

KV_INSTANTIATE(clahe, Clahe)

}  // namespace kv::enhance::cuda
