// Erased parts on CUDA: a block has a tile of all planes of a sample. It marks the erased pixels of the tile as
// bits, once for all planes, and each thread then has 16 bytes of a row. A block of a list finds its sample in the
// table.
#include "augmentation/erase.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kEraseThreads = 256, kEraseWords = kEraseColumns / 32;
// Rows of a tile of a batch with more parts than a block marks at once: fewer tiles look at all of them.
constexpr int kManyRows = 4 * kEraseRows;

// The bits of the columns [begin, end) of a row of the tile.
__device__ __forceinline__ void mark(uint32_t* words, int begin, int end) {
  for (int w = begin / 32; 32 * w < end; ++w) {
    int const low = max(begin - 32 * w, 0), high = min(end - 32 * w, 32);
    atomicOr(words + w, (high == 32 ? ~0u : (1u << high) - 1) & (~0u << low));
  }
}

using TileBits = uint32_t[kManyRows][kEraseWords];

// Marks the erased pixels of the tile of sample b that begins at (left, top).
template <class T>
__device__ __forceinline__ void mark_tile(EraseRectangles<T> const& p, int64_t b, int64_t left, int64_t top,
                                          int columns, int rows, TileBits& erased) {
  int const words = int(ceil_div(columns, 32));
  for (int i = threadIdx.x; i < rows * words; i += kEraseThreads) erased[i / words][i % words] = 0;
  __syncthreads();
  for (int64_t i = threadIdx.x; i < p.num_boxes; i += kEraseThreads) {
    float const* const box = p.box(b, i);
    ErasedRange const down(box[1], box[3], p.x.height);
    int const first = int(max(down.begin - top, int64_t(0))), last = int(min(down.end - top, int64_t(rows)));
    if (first >= last) continue;
    ErasedRange const across(box[0], box[2], p.x.width);
    int const begin = int(max(across.begin - left, int64_t(0))), end = int(min(across.end - left, int64_t(columns)));
    for (int y = first; y < last; ++y) mark(erased[y], begin, end);
  }
}
template <class T>
__device__ __forceinline__ void mark_tile(EraseGrid<T> const& p, int64_t b, int64_t left, int64_t top, int columns,
                                          int rows, TileBits& erased) {
  __shared__ GridLines lines;
  if (threadIdx.x == 0) lines = GridLines(p.grids + b * p.grid_stride, p.x.height, p.x.width);
  __syncthreads();
  int const words = int(ceil_div(columns, 32));
  for (int i = int(threadIdx.x / 32); i < rows * words; i += kEraseThreads / 32) {
    int const y = i / words, word = i % words;
    unsigned const bits = __ballot_sync(~0u, lines.contains(left + 32 * word + threadIdx.x % 32, top + y));
    if (threadIdx.x % 32 == 0) erased[y][word] = bits;
  }
}

template <class T>
__device__ __forceinline__ void mark_tile(EraseMarked<T> const& p, int64_t b, int64_t left, int64_t top, int columns,
                                          int rows, TileBits& erased) {
  int const words = int(ceil_div(columns, 32));
  for (int i = int(threadIdx.x / 32); i < rows * words; i += kEraseThreads / 32) {
    int const y = i / words, word = i % words, column = 32 * word + int(threadIdx.x % 32);
    unsigned const bits = __ballot_sync(~0u, column < columns && p.contains(b, left + column, top + y));
    if (threadIdx.x % 32 == 0) erased[y][word] = bits;
  }
}

// Of the tile of sample b that begins at (left, top), P elements of a row for each thread. A row of a channels-last
// image has all channels of its pixels.
template <int P, bool KeepsErased = false, class Params>
__device__ __forceinline__ void erase_tile(Params const& p, int64_t b, int64_t left, int64_t top, int most_rows,
                                           TileBits& erased) {
  using T = typename Params::Stored;
  static_assert(32 % P == 0, "a vector of one channel has the bits of one word");
  int const rows = int(min(p.x.height - top, int64_t(most_rows))),
            columns = int(min(p.x.width - left, int64_t(kEraseColumns)));
  mark_tile(p, b, left, top, columns, rows, erased);
  __syncthreads();
  int const step = int(p.x.step), vectors = columns * step / P, per_plane = rows * vectors;
  for (int i = threadIdx.x; i < per_plane * int(p.planes_per_sample); i += kEraseThreads) {
    int const c = i / per_plane, y = (i - c * per_plane) / vectors, k = (i - c * per_plane - y * vectors) * P;
    int64_t const plane = b * p.planes_per_sample + c, first = left * step + k;
    Vector<T, P> v = *reinterpret_cast<Vector<T, P> const*>(p.x.row(plane, top + y) + first);
    if constexpr (KeepsErased) {
      Vector<T, P> const kept = *reinterpret_cast<Vector<T, P> const*>(p.y.row(plane, top + y) + first);
#pragma unroll
      for (int j = 0; j < P; ++j) {
        int const column = (k + j) / step;
        if (erased[y][column / 32] >> (column % 32) & 1) v.v[j] = kept.v[j];
      }
    } else if (step == 1) {
      uint32_t const bits = erased[y][k / 32] >> (k % 32);
      T const value = round_to<T>(p.value(b, c, k));
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (bits >> j & 1) v.v[j] = value;
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j) {
        int const column = (k + j) / step;
        if (erased[y][column / 32] >> (column % 32) & 1) v.v[j] = round_to<T>(p.value(b, c, k + j));
      }
    }
    store_vector(p.y.row(plane, top + y) + first, v);
  }
}

template <class Params, int P>
__global__ void __launch_bounds__(kEraseThreads)
    erase_tiles(__grid_constant__ Params const p, unsigned tiles_down, unsigned tiles_across, int rows) {
  __shared__ TileBits erased;
  unsigned const tile_x = blockIdx.x % tiles_across, t = blockIdx.x / tiles_across, tile_y = t % tiles_down;
  erase_tile<P>(p, t / tiles_down, int64_t(tile_x) * kEraseColumns, int64_t(tile_y) * rows, rows, erased);
}

template <class T>
int rows_of_tiles(EraseRectangles<T> const& p) {
  bool const are_many = p.num_boxes > kEraseThreads && p.samples * p.x.height >= multiprocessors() * kManyRows;
  return are_many ? kManyRows : kEraseRows;
}
template <class T>
int rows_of_tiles(EraseGrid<T> const&) {
  return kEraseRows;
}

template <int P, class Params>
int launch_tiles(Params const& p, CUstream_st* stream) {
  int const rows = rows_of_tiles(p);
  unsigned const down = unsigned(ceil_div(p.x.height, rows)), across = unsigned(ceil_div(p.x.width, kEraseColumns));
  erase_tiles<Params, P><<<unsigned(p.samples) * down * across, kEraseThreads, 0, stream>>>(p, down, across, rows);
  return cudaGetLastError();
}

// Whether rows are whole vectors of P elements.
template <int P, class T>
KV_HD bool has_whole_vectors(Planes<T> const& p) {
  constexpr int64_t bytes = P * sizeof(T), size = sizeof(T);
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.row_size() % P == 0 &&
         p.row_stride * size % bytes == 0 && p.outer_stride * size % bytes == 0 && p.inner_stride * size % bytes == 0;
}

template <class Params>
int launch_erase(Params const& p, CUstream_st* stream) {
  constexpr int P = 16 / sizeof(typename Params::Stored);
  return has_whole_vectors<P>(p.x) && has_whole_vectors<P>(p.y) ? launch_tiles<P>(p, stream)
                                                                : launch_tiles<1>(p, stream);
}

template <class All, bool KeepsErased>
__global__ void __launch_bounds__(kEraseThreads) erase_list(__grid_constant__ EraseList<All> const p) {
  __shared__ TileBits erased;
  int const b = p.list.sample_of(int(blockIdx.x)), tile = int(blockIdx.x) - p.list.first[b];
  All const one = p.sample(b);
  int const across = int(ceil_div(one.x.width, kEraseColumns));
  int64_t const left = int64_t(tile % across) * kEraseColumns, top = int64_t(tile / across) * kEraseRows;
  constexpr int P = 16 / sizeof(typename All::Stored);
  if (has_whole_vectors<P>(one.x) && has_whole_vectors<P>(one.y))
    erase_tile<P, KeepsErased>(one, 0, left, top, kEraseRows, erased);
  else
    erase_tile<1, KeepsErased>(one, 0, left, top, kEraseRows, erased);
}

template <class All>
int launch_list(EraseList<All> const& p, CUstream_st* stream) {
  static_assert(sizeof(EraseList<All>) <= 32764, "more than a kernel's parameters");
  auto* const kernel = p.all.keeps_erased() ? erase_list<All, true> : erase_list<All, false>;
  kernel<<<unsigned(p.list.items), kEraseThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int erase_rectangles(EraseRectangles<T> const& p, CUstream_st* stream) {
  return launch_erase(p, stream);
}
template <class T>
int erase_grid(EraseGrid<T> const& p, CUstream_st* stream) {
  return launch_erase(p, stream);
}

template <class T>
int erase_rectangles_list(EraseRectanglesList<T> const& p, CUstream_st* stream) {
  return launch_list<EraseRectangles<T>>(p, stream);
}
template <class T>
int erase_grid_list(EraseGridList<T> const& p, CUstream_st* stream) {
  return launch_list<EraseGrid<T>>(p, stream);
}
template <class T>
int erase_marked_list(EraseMarkedList<T> const& p, CUstream_st* stream) {
  return launch_list<EraseMarked<T>>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(erase_rectangles, EraseRectangles)
KV_INSTANTIATE_WITH_BYTES(erase_grid, EraseGrid)
KV_INSTANTIATE_WITH_BYTES(erase_rectangles_list, EraseRectanglesList)
KV_INSTANTIATE_WITH_BYTES(erase_grid_list, EraseGridList)
KV_INSTANTIATE_WITH_BYTES(erase_marked_list, EraseMarkedList)

}  // namespace kv::augmentation::cuda
