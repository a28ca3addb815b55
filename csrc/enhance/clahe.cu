// CLAHE on CUDA. The first launch builds the tables, one block per tile. The second one maps the pixels: a block
// takes some columns of a row of cells, and interleaves the four tables of each cell in shared memory, four bytes per
// entry.
#include "byte_histogram.cuh"
#include "clahe.h"
#include "core/stencils/filter_list.cuh"

namespace kv::enhance::cuda {
namespace {

// Traverses a rectangle of width x height pixels in vectors of P neighbors: load(x, y) reads one, and f(vector) takes
// it.
template <int Threads, int P, class Load, class F>
__device__ __forceinline__ void for_each_vector(int width, int height, Load load, F f) {
  constexpr int kAtOnce = 4;
  int const across = width / P, down = small_quotient(Threads, across), right = Threads - down * across;  // a step
  int y = small_quotient(int(threadIdx.x), across), x = int(threadIdx.x) - y * across;
  while (y < height) {
    decltype(load(x, y)) vectors[kAtOnce];
    bool inside[kAtOnce];
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i) {
      inside[i] = y < height;
      if (inside[i]) vectors[i] = load(x * P, y);
      x += right, y += down;
      if (x >= across) x -= across, ++y;
    }
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i)
      if (inside[i]) f(vectors[i]);
  }
}

// Whether pixels [begin, end) of a row consist of whole aligned vectors.
template <int P>
__device__ __forceinline__ bool rows_are_aligned(bool aligned, int begin, int end) {
  return aligned && begin % P == 0 && end % P == 0;
}

// The level nearest to v, from 0 to 255.
__device__ __forceinline__ uint8_t nearest_level(float v) {  // as the last bits: conversions take four times as long
  return uint8_t(__float_as_uint(v + 0x1.8p23f));
}
__device__ __forceinline__ uint8_t nearest_level(double v) { return uint8_t(__double2int_rn(v)); }

// A block has the tile (x, y) of a plane.
template <int Threads, class T>
__device__ __forceinline__ void make_table(Clahe<T> const& p, unsigned plane, bool aligned) {
  using F = Compute<T>;
  using Counter = LevelCounter<Threads / 32>;
  constexpr int kEach = Threads < kLevels ? kLevels / Threads : 1;  // levels per thread
  __shared__ __align__(16) int32_t counts[Counter::kSize];
  __shared__ int sums[Threads / 32];
  Counter const counter{counts};
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);  // a count times it is a level
  int const ty = int(blockIdx.y), tx = int(blockIdx.x);
  T const* const image = p.x.plane(plane);
  counter.template clear<Threads>();
  __syncthreads();
  int const x0 = tx * p.across.size, y0 = ty * p.down.size, x1 = x0 + p.across.size, y1 = y0 + p.down.size;
  auto const add = [&](auto&& load) {
    constexpr int P = sizeof(load(0, 0).v) / sizeof(T);
    for_each_vector<Threads, P>(p.across.size, p.down.size, load, [&](Vector<T, P> const& vector) {
#pragma unroll
      for (T const pixel : vector.v) counter.add(level_of(pixel));
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
  bool const has_levels = Threads * kEach == kLevels || first < kLevels;
  int32_t const limit = p.limit_of(plane);
  int count[kEach], above = 0;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    int const all = has_levels ? counter[first + i] : 0;
    count[i] = min(all, limit);
    above += all - count[i];
  }
  Excess const spread(block_sum_to_all(above, sums));
  int own = 0, total;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    if (has_levels) count[i] += spread.of(first + i);
    own += count[i];
  }
  int sum = block_inclusive_scan<Threads>(own, total) - own;
  uint8_t* const table = p.tables_of(plane) + int64_t(ty * p.across.count + tx) * kLevels;
  Vector<uint8_t, kEach> levels;
#pragma unroll
  for (int i = 0; i < kEach; ++i) {
    sum += count[i];
    levels.v[i] = nearest_level(product(F(sum), scale));
  }
  if (has_levels) *reinterpret_cast<Vector<uint8_t, kEach>*>(table + first) = levels;
}

template <class T, int Threads>
__global__ void __launch_bounds__(Threads)
    make_tables(__grid_constant__ Clahe<T> const p, unsigned first_plane, bool aligned) {
  make_table<Threads>(p, first_plane + blockIdx.z, aligned);
}

template <class T, int Threads>
__global__ void __launch_bounds__(Threads)
    make_tables_of_list(__grid_constant__ ClaheList<T> const p, unsigned first_plane, bool aligned) {
  unsigned const plane = first_plane + blockIdx.z, b = plane / unsigned(p.channels);
  if (p.copies(int(b))) return;
  Clahe<T> const one = p.sample(int(b));
  make_table<Threads>(one, plane - b * unsigned(p.channels), aligned);
}

constexpr int kThreads = 128;

// v / 255, rounded like a float division, in a third of its instructions (P. Markstein, "Computation of elementary
// functions on the IBM RISC System/6000 processor", 1990).
__device__ __forceinline__ float over_255(float v) {
  constexpr float one = 1.f / 255;
  float const q = v * one;
  return fmaf(fmaf(-255.f, q, v), one, q);
}
__device__ __forceinline__ double over_255(double v) { return v / 255; }

// Pixels of a vector that is mapped: a thread keeps the cells and weights of as many columns.
template <class T>
constexpr int kMapped = kRowVector<T> < 8 ? kRowVector<T> : 8;
// The columns of a thread, in vectors of P adjacent ones.
template <int P>
constexpr int kColumns = P < 4 ? 4 : P;

// How the cells of a plane are split into blocks.
struct CellBlocks {
  int columns, rows;      // pixels of a block, at most
  int cells;              // the most cells that they are in, along x
  unsigned across, down;  // blocks of a row of cells, along x and along y

  KV_HD CellBlocks(TileAxis const& x, TileAxis const& y, int most = 256) : columns(most) {
    auto const cells_of = [&](int pixels) { return min(x.count + 1, (pixels - 1) / x.size + 2); };
    while (columns > 32 && cells_of(columns) > 64) columns /= 2;  // memory
    cells = cells_of(columns);
    across = unsigned(ceil_div(x.pixels, columns)), down = unsigned(ceil_div(y.size, 64));
    rows = int(ceil_div(y.size, down));
  }
  int bytes() const { return cells * kLevels * int(sizeof(uint32_t)); }
};

// A block has the part x of row y of the cells of a plane. A thread keeps the cells and weights of its columns. Its
// vectors are blockDim.x vectors apart, so that adjacent threads access adjacent memory.
template <int P, class T>
__device__ __forceinline__ void map_part(Clahe<T> const& p, unsigned plane, CellBlocks const& blocks, bool copies) {
  using F = Compute<T>;
  constexpr int kAtOnce = 2, kVectors = kColumns<P> / P;
  extern __shared__ __align__(16) uint32_t tables[];  // of all cells: kLevels entries of the four bytes of a level
  unsigned const chunk = blockIdx.x / blocks.across;
  int const cy = int(blockIdx.y), x0 = int(blockIdx.x - chunk * blocks.across) * blocks.columns;
  int const x1 = min(x0 + blocks.columns, p.across.pixels);
  int const y0 = p.down.cell(cy) + int(chunk) * blocks.rows, y1 = min(p.down.cell(cy + 1), y0 + blocks.rows);
  if (y0 >= y1 || chunk >= blocks.down) return;
  if (copies) {
    int const wide = x1 - x0, threads = int(blockDim.x * blockDim.y);
    for (int i = int(threadIdx.y * blockDim.x + threadIdx.x); i < wide * (y1 - y0); i += threads) {
      int const row = y0 + i / wide, column = x0 + i % wide;
      p.y.row(plane, row)[column * p.y.step] = p.x.row(plane, row)[column * p.x.step];
    }
    return;
  }

  int const x = x0 + int(threadIdx.x) * P, apart = int(blockDim.x) * P, step = int(blockDim.y);
  T const* const from = p.x.plane(plane) + x * p.x.step;
  T* const to = p.y.plane(plane) + x * p.y.step;
  int64_t const apart_from = apart * p.x.step, apart_to = apart * p.y.step;
  auto const has_vector = [&](int v) { return x + v * apart < x1; };
  Vector<T, P> vectors[kAtOnce][kVectors];
  auto const fetch = [&](int i, int y) {
    T const* const row = from + y * p.x.row_stride;
#pragma unroll
    for (int v = 0; v < kVectors; ++v)
      if (y < y1 && has_vector(v)) vectors[i][v] = *reinterpret_cast<Vector<T, P> const*>(row + v * apart_from);
  };
  int start = x < x1 ? y0 + int(threadIdx.y) : y1;
#pragma unroll
  for (int i = 0; i < kAtOnce; ++i) fetch(i, start + i * step);

  uint8_t const* const of_tiles = p.tables_of(plane);
  constexpr int kWords = kLevels / 4;  // of a table; a thread reads word i of the tables of several cells
  int const thread = int(threadIdx.y * blockDim.x + threadIdx.x), i = thread % kWords;
  auto const word = [&](int ty, int tx) {
    return reinterpret_cast<uint32_t const*>(of_tiles + int64_t(ty * p.across.count + tx) * kLevels)[i];
  };
  int const first = p.across.cell_of(x0), cells = p.across.cell_of(x1 - 1) + 1 - first;
#pragma unroll 2
  for (int cell = thread / kWords; cell < cells; cell += kThreads / kWords) {
    int const cx = first + cell;
    uint32_t const a = word(p.down.before(cy), p.across.before(cx)), b = word(p.down.before(cy), p.across.after(cx)),
                   c = word(p.down.after(cy), p.across.before(cx)), d = word(p.down.after(cy), p.across.after(cx));
    Vector<uint32_t, 4> entries;
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      unsigned const pick = k | (k + 4) << 4;  // byte k of both words
      entries.v[k] = __byte_perm(__byte_perm(a, b, pick), __byte_perm(c, d, pick), 0x5410);
    }
    *reinterpret_cast<Vector<uint32_t, 4>*>(tables + cell * kLevels + 4 * i) = entries;
  }
  uint32_t const* table[kColumns<P>];
  F across[kColumns<P>];
#pragma unroll
  for (int k = 0; k < kColumns<P>; ++k) {
    int const column = x + k / P * apart + k % P, cx = p.across.cell_of(column);
    table[k] = tables + (cx - first) * kLevels;
    across[k] = p.across.template weight<F>(column, cx);
  }
  __syncthreads();

#pragma unroll 1
  for (; start < y1; start += kAtOnce * step) {
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i) {
      int const y = start + i * step;
      if (y >= y1) break;
      Vector<T, P> pixels[kVectors];
#pragma unroll
      for (int v = 0; v < kVectors; ++v) pixels[v] = vectors[i][v];
      fetch(i, y + kAtOnce * step);
      F const down = p.down.template weight<F>(y, cy);
      T* const row = to + y * p.y.row_stride;
#pragma unroll
      for (int v = 0; v < kVectors; ++v) {
        if (!has_vector(v)) break;
        F result[P];
#pragma unroll
        for (int k = 0; k < P; ++k) {
          T const pixel = pixels[v].v[k];
          int const level = level_of(pixel), column = v * P + k;
          uint32_t const four = table[column][level & (kLevels - 1)];
          F const value = mixed(byte_of<F>(four, 0), byte_of<F>(four, 1), byte_of<F>(four, 2), byte_of<F>(four, 3),
                                across[column], down);
          if constexpr (sizeof(T) == 1) {
            result[k] = value;
          } else {
            F const mapped = over_255(p.to_levels ? rint(value) : value);
            result[k] = level < kLevels ? mapped : read(pixel);
          }
        }
        store_vector(row + v * apart_to, result);
      }
    }
  }
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    map_cells(__grid_constant__ Clahe<T> const p, unsigned first_plane, CellBlocks const blocks) {
  map_part<P>(p, first_plane + blockIdx.z, blocks, false);
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    map_cells_of_list(__grid_constant__ ClaheList<T> const p, unsigned first_plane, int columns) {
  unsigned const plane = first_plane + blockIdx.z, b = plane / unsigned(p.channels);
  Clahe<T> const one = p.sample(int(b));
  map_part<P>(one, plane - b * unsigned(p.channels), CellBlocks(one.across, one.down, columns), p.copies(int(b)));
}

// Planes are the z axis of a grid: launch(first of them, how many).
template <class Launch>
void for_planes(int64_t planes, Launch launch) {
  constexpr int64_t most = 65535;
  for (int64_t first = 0; first < planes; first += most) launch(unsigned(first), unsigned(min(planes - first, most)));
}
bool has_small_tiles(TileAxis const& down, TileAxis const& across) { return int64_t(down.size) * across.size <= 8192; }
// Vectors of both launches are parts of it.
template <class T>
constexpr int kAlignment = sizeof(T) == 1 ? kMapped<T> : kPixels<T>;
template <class T>
bool has_aligned_rows(Clahe<T> const& p) {
  return is_vectorizable<kAlignment<T>>(p.x) && is_vectorizable<kAlignment<T>>(p.y);
}
template <class T, int P>
dim3 threads_of(int columns) {
  unsigned const across = unsigned(columns / kColumns<P>);
  return {across, kThreads / across};
}

}  // namespace

template <class T>
int clahe(Clahe<T> const& p, CUstream_st* stream) {
  bool const aligned = has_aligned_rows(p);
  CellBlocks const blocks(p.across, p.down);
  int error = 0;
  with_row_vectors<kMapped<T>>(aligned, [&](auto pixels) {
    auto* const kernel = map_cells<T, pixels.value>;
    error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, blocks.bytes());
    if (error) return;
    for_planes(p.x.count(), [&](unsigned first, unsigned count) {
      dim3 const tiles(unsigned(p.across.count), unsigned(p.down.count), count);
      if (has_small_tiles(p.down, p.across))
        make_tables<T, 64><<<tiles, 64, 0, stream>>>(p, first, aligned);
      else
        make_tables<T, 512><<<tiles, 512, 0, stream>>>(p, first, aligned);
      dim3 const grid(blocks.across * blocks.down, unsigned(p.down.count + 1), count);
      kernel<<<grid, threads_of<T, pixels.value>(blocks.columns), blocks.bytes(), stream>>>(p, first, blocks);
    });
  });
  return error ? error : int(cudaGetLastError());
}

// The blocks of all samples have the same columns and as much memory as one of them needs.
template <class T>
int clahe_list(ClaheList<T> const& p, CUstream_st* stream) {
  bool const aligned = all_samples(p, [](Clahe<T> const& one) { return has_aligned_rows(one); });
  bool const small = all_samples(p, [](Clahe<T> const& one) { return has_small_tiles(one.down, one.across); });
  int columns = 256, cells = 1;
  unsigned parts = 1;
  for (int b = 0; b < p.list.count; ++b) {
    Clahe<T> const one = p.sample(b);
    columns = CellBlocks(one.across, one.down, columns).columns;
  }
  for (int b = 0; b < p.list.count; ++b) {
    Clahe<T> const one = p.sample(b);
    CellBlocks const blocks(one.across, one.down, columns);
    cells = max(cells, blocks.cells), parts = max(parts, blocks.across * blocks.down);
  }
  int const bytes = cells * kLevels * int(sizeof(uint32_t));
  int error = 0;
  with_row_vectors<kMapped<T>>(aligned, [&](auto pixels) {
    auto* const kernel = map_cells_of_list<T, pixels.value>;
    error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes);
    if (error) return;
    for_planes(int64_t(p.list.count) * p.channels, [&](unsigned first, unsigned count) {
      dim3 const tiles(unsigned(p.columns), unsigned(p.rows), count);
      if (small)
        make_tables_of_list<T, 64><<<tiles, 64, 0, stream>>>(p, first, aligned);
      else
        make_tables_of_list<T, 512><<<tiles, 512, 0, stream>>>(p, first, aligned);
      dim3 const grid(parts, unsigned(p.rows + 1), count);
      kernel<<<grid, threads_of<T, pixels.value>(columns), unsigned(bytes), stream>>>(p, first, columns);
    });
  });
  return error ? error : int(cudaGetLastError());
}

KV_INSTANTIATE_WITH_BYTES(clahe, Clahe)
KV_INSTANTIATE_WITH_BYTES(clahe_list, ClaheList)

}  // namespace kv::enhance::cuda
