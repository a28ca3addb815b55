// CLAHE on CUDA. The first launch builds the tables, one block per tile. The second one maps the pixels, a few blocks
// per cell: each block interleaves the cell's four tables in shared memory, four bytes per entry.
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
  __shared__ int32_t counts[Counter::kSize];
  Counter const counter{counts};
  unsigned const tiles = unsigned(p.down.count * p.across.count), plane = blockIdx.x / tiles;
  int const tile = int(blockIdx.x - plane * tiles), ty = tile / p.across.count, tx = tile - ty * p.across.count;
  T const* const image = p.x.plane(plane);
  counter.clear();
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

constexpr int kThreads = 64;  // larger blocks spend most of their time on the cell's tables

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

template <class T>
__global__ void __launch_bounds__(kThreads) map_cells(Clahe<T> p, bool aligned, int chunks) {
  using F = Compute<T>;
  __shared__ uint32_t cell[kLevels];
  int const across = p.across.count + 1, down = p.down.count + 1;
  unsigned const index = blockIdx.x / chunks, plane = index / unsigned(across * down);
  int const chunk = int(blockIdx.x - index * chunks), position = int(index - plane * unsigned(across * down));
  int const cy = position / across, cx = position - cy * across;
  int const x0 = p.across.cell(cx), x1 = p.across.cell(cx + 1), top = p.down.cell(cy), rows = p.down.cell(cy + 1) - top;
  int const y0 = top + int(int64_t(rows) * chunk / chunks), y1 = top + int(int64_t(rows) * (chunk + 1) / chunks);
  if (x0 >= x1 || y0 >= y1) return;

  uint8_t const* const tables = p.tables + int64_t(plane) * p.down.count * p.across.count * kLevels;
  auto const word = [&](int ty, int tx, int i) {  // levels 4 i to 4 i + 3
    return reinterpret_cast<uint32_t const*>(tables + (ty * p.across.count + tx) * kLevels)[i];
  };
  static_assert(kThreads == kLevels / 4, "a word of each table a thread");
  int const i = threadIdx.x;
  uint32_t const a = word(p.down.before(cy), p.across.before(cx), i),
                 b = word(p.down.before(cy), p.across.after(cx), i), c = word(p.down.after(cy), p.across.before(cx), i),
                 d = word(p.down.after(cy), p.across.after(cx), i);
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    unsigned const pick = k | (k + 4) << 4;  // byte k of both words
    cell[4 * i + k] = __byte_perm(__byte_perm(a, b, pick), __byte_perm(c, d, pick), 0x5410);
  }
  __syncthreads();

  T const* const from = p.x.plane(plane) + y0 * p.x.row_stride;
  T* const to = p.y.plane(plane) + y0 * p.y.row_stride;
  auto const map = [&](auto&& load, auto&& store) {
    constexpr int P = sizeof(load(0, 0).v) / sizeof(T);
    for_each_vector<kThreads, P>(x1 - x0, y1 - y0, load, [&](int x) {
      F across[P];
#pragma unroll
      for (int k = 0; k < P; ++k) across[k] = p.across.template weight<F>(x0 + x + k, cx);
      return [=, &p, &store](int y, Vector<T, P> const& vector) {
        F const down = p.down.template weight<F>(y0 + y, cy);
        F v[P];
#pragma unroll
        for (int k = 0; k < P; ++k) {
          int const level = level_of(vector.v[k]);
          uint32_t const four = cell[level & (kLevels - 1)];
          v[k] = mixed(byte_of<F>(four, 0), byte_of<F>(four, 1), byte_of<F>(four, 2), byte_of<F>(four, 3), across[k],
                       down);
          v[k] = level < kLevels ? over_255(p.to_levels ? rint(v[k]) : v[k]) : read(vector.v[k]);
        }
        store(x, y, v);
      };
    });
  };
  if (rows_are_aligned<kPixels<T>>(aligned, x0, x1))
    map([&](int x,
            int y) { return *reinterpret_cast<Vector<T, kPixels<T>> const*>(from + y * p.x.row_stride + x0 + x); },
        [&](int x, int y, auto const& v) { store_vector(to + y * p.y.row_stride + x0 + x, v); });
  else
    map([&](int x, int y) { return Vector<T, 1>{from[y * p.x.row_stride + (x0 + x) * p.x.step]}; },
        [&](int x, int y, auto const& v) { to[y * p.y.row_stride + (x0 + x) * p.y.step] = round_to<T>(v[0]); });
}

}  // namespace

template <class T>
int clahe(Clahe<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count(), tile = int64_t(p.down.size) * p.across.size;
  unsigned const tiles = unsigned(planes * p.down.count * p.across.count);
  bool const aligned = is_vectorizable<kPixels<T>>(p.x) && is_vectorizable<kPixels<T>>(p.y);
  if (tile <= 2048)
    make_tables<T, 64><<<tiles, 64, 0, stream>>>(p, aligned);
  else
    make_tables<T, 512><<<tiles, 512, 0, stream>>>(p, aligned);
  int const chunks = int(ceil_div(tile, 16 << 10));
  map_cells<<<unsigned(planes * (p.down.count + 1) * (p.across.count + 1) * chunks), kThreads, 0, stream>>>(p, aligned,
                                                                                                            chunks);
  return cudaGetLastError();
}

KV_INSTANTIATE(clahe, Clahe)

}  // namespace kv::enhance::cuda
