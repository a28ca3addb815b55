// CLAHE on CUDA. The first launch builds the tables, one block per tile. The second one maps the pixels: a block
// takes some columns of a row of cells, and interleaves the four tables of each cell in shared memory, four bytes per
// entry.
#include "byte_histogram.cuh"
#include "clahe.h"

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

// A block has the tile (x, y) of plane first_plane + z. A count times `scale` is a level.
template <class T, int Threads>
__global__ void __launch_bounds__(Threads)
    make_tables(__grid_constant__ Clahe<T> const p, unsigned first_plane, bool aligned, Compute<T> scale) {
  using F = Compute<T>;
  using Counter = LevelCounter<Threads / 32>;
  constexpr int kEach = Threads < kLevels ? kLevels / Threads : 1;  // levels per thread
  __shared__ __align__(16) int32_t counts[Counter::kSize];
  __shared__ int sums[Threads / 32];
  Counter const counter{counts};
  unsigned const plane = first_plane + blockIdx.z;
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

  CellBlocks(TileAxis const& x, TileAxis const& y) : columns(256) {
    auto const cells_of = [&](int pixels) { return min(x.count + 1, (pixels - 1) / x.size + 2); };
    while (columns > 32 && cells_of(columns) > 64) columns /= 2;  // memory
    cells = cells_of(columns);
    across = unsigned(ceil_div(x.pixels, columns)), down = unsigned(ceil_div(y.size, 64));
    rows = int(ceil_div(y.size, down));
  }
  int bytes() const { return cells * kLevels * int(sizeof(uint32_t)); }
};

// A block has the part x of row y of the cells of plane first_plane + z. A thread keeps the cells and weights of its
// columns. Its vectors are blockDim.x vectors apart, so that adjacent threads access adjacent memory.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    map_cells(__grid_constant__ Clahe<T> const p, unsigned first_plane, CellBlocks const blocks) {
  using F = Compute<T>;
  constexpr int kAtOnce = 2, kVectors = kColumns<P> / P;
  extern __shared__ __align__(16) uint32_t tables[];  // of all cells: kLevels entries of the four bytes of a level
  unsigned const plane = first_plane + blockIdx.z, chunk = blockIdx.x / blocks.across;
  int const cy = int(blockIdx.y), x0 = int(blockIdx.x - chunk * blocks.across) * blocks.columns;
  int const x1 = min(x0 + blocks.columns, p.across.pixels);
  int const y0 = p.down.cell(cy) + int(chunk) * blocks.rows, y1 = min(p.down.cell(cy + 1), y0 + blocks.rows);
  if (y0 >= y1) return;

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

// Planes are the z axis of a grid.
constexpr int64_t kMaxPlanes = 65535;

template <int Threads, class T>
void launch_tables(Clahe<T> const& p, unsigned first_plane, unsigned planes, bool aligned, CUstream_st* stream) {
  using F = Compute<T>;
  dim3 const grid(unsigned(p.across.count), unsigned(p.down.count), planes);
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);
  make_tables<T, Threads><<<grid, Threads, 0, stream>>>(p, first_plane, aligned, scale);
}

}  // namespace

template <class T>
int clahe(Clahe<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count();
  constexpr int kVector = sizeof(T) == 1 ? kMapped<T> : kPixels<T>;  // those of both launches are parts of it
  bool const aligned = is_vectorizable<kVector>(p.x) && is_vectorizable<kVector>(p.y);
  bool const small = int64_t(p.down.size) * p.across.size <= 8192;
  CellBlocks const blocks(p.across, p.down);
  int error = 0;
  with_row_vectors<kMapped<T>>(aligned, [&](auto pixels) {
    auto* const kernel = map_cells<T, pixels.value>;
    unsigned const threads_across = unsigned(blocks.columns / kColumns<pixels.value>);
    dim3 const threads(threads_across, kThreads / threads_across);
    error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, blocks.bytes());
    for (int64_t first = 0; !error && first < planes; first += kMaxPlanes) {
      unsigned const count = unsigned(min(planes - first, kMaxPlanes)), first_plane = unsigned(first);
      if (small)
        launch_tables<64>(p, first_plane, count, aligned, stream);
      else
        launch_tables<512>(p, first_plane, count, aligned, stream);
      dim3 const grid(blocks.across * blocks.down, unsigned(p.down.count + 1), count);
      kernel<<<grid, threads, blocks.bytes(), stream>>>(p, first_plane, blocks);
    }
  });
  return error ? error : int(cudaGetLastError());
}

KV_INSTANTIATE_WITH_BYTES(clahe, Clahe)

}  // namespace kv::enhance::cuda
