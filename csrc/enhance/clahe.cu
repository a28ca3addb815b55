// CLAHE on CUDA: one launch makes the tables, one block a tile; one maps the pixels, a few blocks a cell, each with the
// cell's four tables as one of four bytes an entry in shared memory.
#include "clahe.h"
#include "levels.cuh"

namespace kv::cuda {
namespace {

// Calls f(x, y, pixel) for the pixels of a rectangle, row by row, a thread four of them at once; at(x, y) is where a
// pixel is.
template <int Threads, class T, class At, class F>
__device__ __forceinline__ void for_each_pixel(int x0, int y0, int width, int height, At at, F f) {
  constexpr int kAtOnce = 4;
  int const rows = Threads / width, rest = Threads - rows * width;  // how far the next pixel of a thread is
  int y = int(threadIdx.x) / width, x = int(threadIdx.x) - y * width;
  while (y < height) {
    T pixels[kAtOnce];
    int xs[kAtOnce], ys[kAtOnce];
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i) {
      xs[i] = x0 + x, ys[i] = y < height ? y0 + y : -1;
      if (ys[i] >= 0) pixels[i] = *at(xs[i], ys[i]);
      x += rest, y += rows;
      if (x >= width) x -= width, ++y;
    }
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i)
      if (ys[i] >= 0) f(xs[i], ys[i], pixels[i]);
  }
}

template <class T, int Threads>
__global__ void __launch_bounds__(Threads) make_tables(Clahe<T> p) {
  using F = Compute<T>;
  using Counter = LevelCounter<Threads / 32>;
  constexpr int kEach = Threads < kLevels ? kLevels / Threads : 1;  // levels a thread
  __shared__ int32_t counts[Counter::kSize];
  Counter const counter{counts};
  unsigned const tiles = unsigned(p.down.count * p.across.count), plane = blockIdx.x / tiles;
  int const tile = int(blockIdx.x - plane * tiles), ty = tile / p.across.count, tx = tile - ty * p.across.count;
  T const* const image = p.x.plane(plane);
  counter.clear();
  __syncthreads();
  for_each_pixel<Threads, T>(
      tx * p.across.size, ty * p.down.size, p.across.size, p.down.size,
      [&](int x, int y) { return image + p.down.reflected(y) * p.x.row_stride + p.across.reflected(x) * p.x.step; },
      [&](int, int, T pixel) { counter.add(level_of(pixel)); });
  __syncthreads();

  int const first = int(threadIdx.x) * kEach;
  int count[kEach], above = 0, total;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    int const all = first + i < kLevels ? counter[first + i] : 0;
    count[i] = min(all, p.limit);
    above += all - count[i];
  }
  sum_up_to<Threads>(above, total);
  Excess const spread(total);
  int own = 0;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    if (first + i < kLevels) count[i] += spread.of(first + i);
    own += count[i];
  }
  int sum = sum_up_to<Threads>(own, total) - own;
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);
  uint8_t* const table = p.tables + int64_t(blockIdx.x) * kLevels;
  Pack<uint8_t, kEach> levels;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    sum += count[i];
    levels.v[i] = uint8_t(rint(min(F(sum) * scale, F(255))));
  }
  if (first < kLevels) *reinterpret_cast<Pack<uint8_t, kEach>*>(table + first) = levels;
}

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) map_cells(Clahe<T> p, int pieces) {
  using F = Compute<T>;
  __shared__ uint32_t cell[kLevels];
  int const across = p.across.count + 1, down = p.down.count + 1;
  unsigned const index = blockIdx.x / pieces, plane = index / unsigned(across * down);
  int const piece = int(blockIdx.x - index * pieces), place = int(index - plane * unsigned(across * down));
  int const cy = place / across, cx = place - cy * across;
  int const x0 = p.across.cell(cx), x1 = p.across.cell(cx + 1), top = p.down.cell(cy), rows = p.down.cell(cy + 1) - top;
  int const y0 = top + int(int64_t(rows) * piece / pieces), y1 = top + int(int64_t(rows) * (piece + 1) / pieces);
  if (x0 >= x1 || y0 >= y1) return;

  uint8_t const* const tables = p.tables + int64_t(plane) * p.down.count * p.across.count * kLevels;
  auto const word = [&](int ty, int tx, int i) {  // levels 4 i to 4 i + 3
    return reinterpret_cast<uint32_t const*>(tables + (ty * p.across.count + tx) * kLevels)[i];
  };
  if (threadIdx.x < kLevels / 4) {
    int const i = threadIdx.x;
    uint32_t const a = word(p.down.before(cy), p.across.before(cx), i),
                   b = word(p.down.before(cy), p.across.after(cx), i),
                   c = word(p.down.after(cy), p.across.before(cx), i),
                   d = word(p.down.after(cy), p.across.after(cx), i);
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      unsigned const pick = k | (k + 4) << 4;  // byte k of both
      cell[4 * i + k] = __byte_perm(__byte_perm(a, b, pick), __byte_perm(c, d, pick), 0x5410);
    }
  }
  __syncthreads();

  T const* const from = p.x.plane(plane);
  T* const to = p.y.plane(plane);
  for_each_pixel<kThreads, T>(
      x0, y0, x1 - x0, y1 - y0, [&](int x, int y) { return from + y * p.x.row_stride + x * p.x.step; },
      [&](int x, int y, T pixel) {
        int const level = level_of(pixel);
        F v = read(pixel);
        if (level < kLevels) {
          uint32_t const four = cell[level];
          v = mixed(F(four & 255), F(four >> 8 & 255), F(four >> 16 & 255), F(four >> 24),
                    p.across.template weight<F>(x, cx), p.down.template weight<F>(y, cy));
          v = (p.to_levels ? rint(v) : v) / 255;
        }
        to[y * p.y.row_stride + x * p.y.step] = round_to<T>(v);
      });
}

}  // namespace

template <class T>
int clahe(Clahe<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count(), tile = int64_t(p.down.size) * p.across.size;
  unsigned const tiles = unsigned(planes * p.down.count * p.across.count);
  if (tile <= 2048)
    make_tables<T, 64><<<tiles, 64, 0, stream>>>(p);
  else
    make_tables<T, 512><<<tiles, 512, 0, stream>>>(p);
  int const pieces = int(ceil_div(tile, 16 << 10));
  map_cells<<<unsigned(planes * (p.down.count + 1) * (p.across.count + 1) * pieces), kThreads, 0, stream>>>(p, pieces);
  return cudaGetLastError();
}

KV_INSTANTIATE(clahe, Clahe)

}  // namespace kv::cuda
