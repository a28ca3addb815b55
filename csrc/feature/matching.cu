// The two nearest descriptors on CUDA: a block of threads computes tiles of distances of some descriptors of the first
// set and, one tile after the other, a part of the second set. A thread has 8 x 8 distances in registers (4 x 4 of
// float64), in groups of 4 adjacent ones; 16 components of the tile's descriptors are in shared memory at a time.
#include "core/block_reduce.cuh"
#include "feature/matching.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 256, kDepth = 16;  // kDepth: components in shared memory
constexpr unsigned kAllLanes = 0xffffffffu;

// The row or column of a tile that element i of thread t of 16 has.
template <int Tile>
__device__ __forceinline__ int in_tile(int t, int i) {
  return (i / 4) * 64 + t * 4 + i % 4;
}

// Components [from, from + kDepth) of the descriptors [start, start + Tile), read by all threads. NaN where there is no
// descriptor, 0 after the last component.
template <int Tile, class T>
struct TileReader {
  static constexpr int kElements = Tile * kDepth / kThreads;
  T next[kElements];

  __device__ __forceinline__ void fetch(TwoNearest<T> const& p, DescriptorSet<T> const& set, int64_t b, int start,
                                        int from) {
#pragma unroll
    for (int e = 0; e < kElements; ++e) {
      int const i = start + int(threadIdx.x) / kDepth + e * (kThreads / kDepth), d = from + threadIdx.x % kDepth;
      T x = T(__builtin_nan(""));
      if (d >= p.width)
        x = 0;
      else if (p.is_valid(set, b, i))
        x = set.values[(b * set.count + i) * p.width + d];
      next[e] = x;
    }
  }
  __device__ __forceinline__ void store(T (&tile)[kDepth][Tile + 4]) const {
#pragma unroll
    for (int e = 0; e < kElements; ++e)
      tile[threadIdx.x % kDepth][threadIdx.x / kDepth + e * (kThreads / kDepth)] = next[e];
  }
};

struct MergeNeighbors {
  template <class T>
  __device__ __forceinline__ Neighbors<T> operator()(Neighbors<T> a, Neighbors<T> const& b) const {
    a.merge(b);
    return a;
  }
};

template <class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 4 ? 2 : 1) find(__grid_constant__ TwoNearest<T> const p) {
  constexpr int kTile = kMatchingTile<T>, R = kTile / 16;
  DescriptorSet<T> const &first = p.first, &second = p.second;
  __shared__ __align__(16) T rows[kDepth][kTile + 4];
  __shared__ __align__(16) T columns[kDepth][kTile + 4];
  __shared__ Neighbors<T> of_rows[kTile];
  __shared__ Neighbors<T> of_columns[kThreads / 32][kTile];

  unsigned const row_tiles = unsigned(ceil_div(first.count, kTile)), tile_index = blockIdx.x / first.splits;
  int const split = blockIdx.x % first.splits, tile_of_rows = tile_index % row_tiles;
  int64_t const b = tile_index / row_tiles;
  int const tx = threadIdx.x % 16, ty = threadIdx.x / 16, start1 = tile_of_rows * kTile;
  int const tiles = (second.count + kTile - 1) / kTile;
  for (int i = threadIdx.x; i < kTile; i += kThreads) of_rows[i] = Neighbors<T>::none();

  for (int tile = split; tile < tiles; tile += first.splits) {
    int const start2 = tile * kTile;
    T square[R][R] = {};
    TileReader<kTile, T> row_reader, column_reader;
    row_reader.fetch(p, first, b, start1, 0);
    column_reader.fetch(p, second, b, start2, 0);
    for (int from = 0; from < p.width; from += kDepth) {
      __syncthreads();
      row_reader.store(rows);
      column_reader.store(columns);
      __syncthreads();
      if (from + kDepth < p.width) {
        row_reader.fetch(p, first, b, start1, from + kDepth);
        column_reader.fetch(p, second, b, start2, from + kDepth);
      }
#pragma unroll
      for (int d = 0; d < kDepth; ++d) {
        T x[R], y[R];
#pragma unroll
        for (int i = 0; i < R; i += 4) {
          *reinterpret_cast<Vector<T, 4>*>(x + i) =
              *reinterpret_cast<Vector<T, 4> const*>(&rows[d][in_tile<kTile>(ty, i)]);
          *reinterpret_cast<Vector<T, 4>*>(y + i) =
              *reinterpret_cast<Vector<T, 4> const*>(&columns[d][in_tile<kTile>(tx, i)]);
        }
#pragma unroll
        for (int i = 0; i < R; ++i)
#pragma unroll
          for (int j = 0; j < R; ++j) {
            T const difference = x[i] - y[j];
            square[i][j] += difference * difference;
          }
      }
    }
    if (first.positions)
#pragma unroll
      for (int i = 0; i < R; ++i)
#pragma unroll
        for (int j = 0; j < R; ++j) {
          int const row = start1 + in_tile<kTile>(ty, i), column = start2 + in_tile<kTile>(tx, j);
          if (row < first.count && column < second.count && !p.counts(b, row, column))
            square[i][j] = T(__builtin_nan(""));
        }

    // The neighbors of rows: 16 lanes of a warp have a row. They are merged only if a lane has one that is near enough.
#pragma unroll
    for (int i = 0; i < R; ++i) {
      int const row = in_tile<kTile>(ty, i);
      Neighbors<T> neighbors = Neighbors<T>::none();
      T const farthest = of_rows[row].square[1];
      bool is_near = false;
#pragma unroll
      for (int j = 0; j < R; ++j) is_near = is_near || square[i][j] <= farthest;
      if (!__any_sync(kAllLanes, is_near)) continue;
#pragma unroll
      for (int j = 0; j < R; ++j) neighbors.insert(square[i][j], start2 + in_tile<kTile>(tx, j));
      neighbors = warp_reduce<16>(neighbors, MergeNeighbors());
      __syncwarp();  // all lanes have read `farthest`
      if (tx == 0) of_rows[row].merge(neighbors);
      __syncwarp();
    }

    // The neighbors of columns: two lanes of each of the 8 warps have a column.
    if (second.partial) {
#pragma unroll
      for (int j = 0; j < R; ++j) {
        Neighbors<T> neighbors = Neighbors<T>::none();
#pragma unroll
        for (int i = 0; i < R; ++i) neighbors.insert(square[i][j], start1 + in_tile<kTile>(ty, i));
        neighbors = warp_reduce<32, 16>(neighbors, MergeNeighbors());
        if (threadIdx.x % 32 < 16) of_columns[threadIdx.x / 32][in_tile<kTile>(tx, j)] = neighbors;
      }
      __syncthreads();
      for (int c = threadIdx.x; c < kTile && start2 + c < second.count; c += kThreads) {
        Neighbors<T> neighbors = of_columns[0][c];
#pragma unroll
        for (int w = 1; w < kThreads / 32; ++w) neighbors.merge(of_columns[w][c]);
        second.partial[(b * second.splits + tile_of_rows) * second.count + start2 + c] = neighbors;
      }
    }
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kTile && start1 + i < first.count; i += kThreads)
    first.partial[(b * first.splits + split) * first.count + start1 + i] = of_rows[i];
}

template <class T>
__global__ void __launch_bounds__(kThreads) merge(__grid_constant__ TwoNearest<T> const p) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x, of_first = p.batch * p.first.count;
  if (i < of_first)
    merge_neighbors(p.first, i);
  else if (p.second.partial && i < of_first + p.batch * p.second.count)
    merge_neighbors(p.second, i - of_first);
}

// Adds the gradient of the distance of x and y, over the threads of a warp, to that of x.
template <class T>
__device__ __forceinline__ void add_gradient(T const* x, T const* y, T grad, int width, T* grad_x) {
  T square = 0;
  for (int d = threadIdx.x % 32; d < width; d += 32) square += (x[d] - y[d]) * (x[d] - y[d]);
  T const weight = distance_vjp(grad, warp_reduce(square, Sum()));
  if (weight == 0) return;
  for (int d = threadIdx.x % 32; d < width; d += 32) grad_x[d] += weight * (x[d] - y[d]);
}

// A warp for each descriptor: its own neighbors, then those that it is a neighbor of, in order.
template <class T>
__global__ void __launch_bounds__(kThreads) differentiate(__grid_constant__ TwoNearestBackward<T> const p) {
  int const rows = p.first.count + p.second.count, lane = threadIdx.x % 32;
  int64_t const warp = blockIdx.x * int64_t(kThreads / 32) + threadIdx.x / 32, b = warp / rows;
  if (b >= p.batch) return;
  int i = int(warp - b * rows);
  bool const in_second = i >= p.first.count;
  NeighborGradient<T> const &own = in_second ? p.second : p.first, &other = in_second ? p.first : p.second;
  if (in_second) i -= p.first.count;
  T const* const x = own.values + (b * own.count + i) * p.width;
  T const* const others = other.values + b * other.count * p.width;
  T* const grad_x = own.grad_values + (b * own.count + i) * p.width;
  for (int d = lane; d < p.width; d += 32) grad_x[d] = 0;
  if (i < own.listed)
    for (int k = 0; k < own.neighbors; ++k) {
      int64_t const at = own.neighbors * (b * own.listed + i) + k, j = own.index(at);
      if (j >= 0 && j < other.count && own.grad[at] != 0)
        add_gradient(x, others + j * p.width, own.grad[at], p.width, grad_x);
    }
  // Pairs without a gradient are skipped: few pairs are matches, but some descriptors are neighbors of hundreds of
  // others.
  int const neighbors = other.neighbors;
  int64_t const size = int64_t(neighbors) * other.listed, offset = b * size;
  T const* const grads = other.grad + offset;
  for (int64_t start = 0; start < size; start += 32) {
    int64_t const of_lane = start + lane;
    bool const points_here = of_lane < size && other.index(offset + of_lane) == i && grads[of_lane] != 0;
    for (unsigned lanes = __ballot_sync(kAllLanes, points_here); lanes; lanes &= lanes - 1) {
      int64_t const at = start + __ffs(int(lanes)) - 1;
      add_gradient(x, others + at / neighbors * p.width, grads[at], p.width, grad_x);
    }
  }
}

constexpr int kSelectThreads = 1024, kRounds = 8;

// One block per sample traverses its descriptors in order, kRounds for each thread at a time.
template <class T>
__global__ void __launch_bounds__(kSelectThreads) select(__grid_constant__ SelectMatches<T> const p) {
  __shared__ int before[kRounds][kSelectThreads / 32], total;  // matches of each warp, then those before them
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int64_t const sample = blockIdx.x;
  int size = 0;
  for (int start = 0; start < p.count1; start += kRounds * kSelectThreads) {
    T scores[kRounds];
    unsigned matches[kRounds];
#pragma unroll
    for (int r = 0; r < kRounds; ++r) {
      int const i = start + r * kSelectThreads + int(threadIdx.x);
      matches[r] = __ballot_sync(kAllLanes, i < p.count1 && p.is_match(sample, i, scores[r]));
      if (lane == 0) before[r][warp] = __popc(matches[r]);
    }
    __syncthreads();
    if (warp == 0) {  // eight counts for each lane
      int* const own = &before[0][0] + lane * kRounds;
      int of_lane = 0;
#pragma unroll
      for (int k = 0; k < kRounds; ++k) of_lane += own[k];
      int sum = warp_prefix_sum(of_lane);
      if (lane == 31) total = sum;
      sum -= of_lane;
#pragma unroll
      for (int k = 0; k < kRounds; ++k) {
        int const count = own[k];
        own[k] = sum, sum += count;
      }
    }
    __syncthreads();
#pragma unroll
    for (int r = 0; r < kRounds; ++r)
      if (matches[r] >> lane & 1)
        p.store(sample, size + before[r][warp] + __popc(matches[r] & ((1u << lane) - 1)),
                start + r * kSelectThreads + int(threadIdx.x), scores[r]);
    size += total;
    __syncthreads();  // before the next counts
  }
  if (threadIdx.x == 0) p.sizes[sample] = size;
  for (int slot = size + int(threadIdx.x); slot < p.count1; slot += kSelectThreads) p.clear(sample, slot);
}

template <class T>
__global__ void __launch_bounds__(kThreads) differentiate_scores(__grid_constant__ SelectMatchesBackward<T> const p) {
  int64_t const slot = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (slot < p.batch * p.count1) p.store(slot);
}

}  // namespace

template <class T>
int two_nearest(TwoNearest<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 4) {
    if (p.first.half_squares) return find_matching_candidates(p, stream);
    if (!p.first.partial) return find_matching_neighbors(p, stream);
  }
  unsigned const blocks = unsigned(p.batch * ceil_div(p.first.count, kMatchingTile<T>) * p.first.splits);
  find<T><<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int two_nearest_merge(TwoNearest<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 4)
    if (p.first.half_squares) return choose_matching_neighbors(p, stream);
  int64_t const elements = p.batch * (p.first.count + (p.second.partial ? p.second.count : 0));
  merge<T><<<unsigned(ceil_div(elements, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int two_nearest_backward(TwoNearestBackward<T> const& p, CUstream_st* stream) {
  int64_t const warps = p.batch * (int64_t(p.first.count) + p.second.count);
  differentiate<T><<<unsigned(ceil_div(warps, kThreads / 32)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int select_matches(SelectMatches<T> const& p, CUstream_st* stream) {
  select<T><<<unsigned(p.batch), kSelectThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int select_matches_backward(SelectMatchesBackward<T> const& p, CUstream_st* stream) {
  differentiate_scores<T><<<unsigned(ceil_div(p.batch * p.count1, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(two_nearest, TwoNearest)
KV_INSTANTIATE_COMPUTED(two_nearest_merge, TwoNearest)
KV_INSTANTIATE_COMPUTED(two_nearest_backward, TwoNearestBackward)
KV_INSTANTIATE_COMPUTED(select_matches, SelectMatches)
KV_INSTANTIATE_COMPUTED(select_matches_backward, SelectMatchesBackward)

}  // namespace kv::feature::cuda
