// The two nearest descriptors on CUDA for float32: from |a - b|^2 / 2 = |a|^2 / 2 + |b|^2 / 2 - a . b, which takes half
// the instructions of a sum of squared differences but loses digits, a tile finds the three nearest candidates of its
// rows and columns. A warp for each descriptor then computes the distances of the nearest candidates of all tiles as
// sums of squared differences. A pair that is no candidate has at least the third distance of its tile; where this does
// not exclude it, rounding included, all distances of the descriptor are computed.
#include "core/launch.cuh"
#include "feature/matching.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32, kTile = kMatchingTile<float>, kDepth = 16, R = kTile / 16;
constexpr unsigned kAllLanes = 0xffffffffu, kColumnBits = kTile - 1;
constexpr float kInfinity = __builtin_inff();
static_assert(kTile == 128);

// The row or column of a tile that element i of thread t of 16 has.
__device__ __forceinline__ int in_tile(int t, int i) { return (i / 4) * 64 + t * 4 + i % 4; }

// A candidate: half the squared distance, whose last bits are replaced by the row or column of the tile. Numbers that
// are not negative have the order of their bits.
__device__ __forceinline__ int candidate(float half_square, int at) {
  return int((__float_as_uint(half_square) & ~kColumnBits) | unsigned(at));
}
__device__ __forceinline__ float half_square_of(int candidate) {
  return __uint_as_float(unsigned(candidate) & ~kColumnBits);
}

__device__ __forceinline__ void insert(Candidates& list, int x) {
  int const second = max(list.v[0], x), third = max(list.v[1], second);
  list.v[0] = min(list.v[0], x), list.v[1] = min(list.v[1], second), list.v[2] = min(list.v[2], third);
}
// The three smallest of two lists.
__device__ __forceinline__ Candidates merged(Candidates const& a, Candidates const& b) {
  return {{min(a.v[0], b.v[0]), min(max(a.v[0], b.v[0]), min(a.v[1], b.v[1])),
           min(min(a.v[2], b.v[2]), min(max(a.v[1], b.v[0]), max(a.v[0], b.v[1])))}};
}

// Merges N lists of two lanes that differ in bit `Lane`: of each pair of halves a lane keeps one.
template <int Lane, int N>
__device__ __forceinline__ void merge_halves(Candidates (&lists)[N], Candidates (&kept)[N / 2]) {
  bool const is_upper = threadIdx.x & Lane;
#pragma unroll
  for (int i = 0; i < N / 2; ++i) {
    Candidates own, others;
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      own.v[k] = is_upper ? lists[i + N / 2].v[k] : lists[i].v[k];
      others.v[k] = __shfl_xor_sync(kAllLanes, is_upper ? lists[i].v[k] : lists[i + N / 2].v[k], Lane);
    }
    kept[i] = merged(own, others);
  }
}

// Half of the squared lengths, inf for descriptors that have no neighbors. A warp for each descriptor of both sets.
__global__ void __launch_bounds__(kThreads) half_squares(__grid_constant__ TwoNearest<float> const p) {
  int64_t const warp = blockIdx.x * int64_t(kWarps) + threadIdx.x / 32, firsts = p.batch * p.first.count;
  bool const in_second = warp >= firsts;
  DescriptorSet<float> const& set = in_second ? p.second : p.first;
  int64_t const i = in_second ? warp - firsts : warp;
  if (i >= p.batch * set.count) return;
  float sum = 0;
  for (int d = threadIdx.x % 32; d < p.width; d += 32) sum += set.values[i * p.width + d] * set.values[i * p.width + d];
  sum = warp_reduce(sum, Sum());
  bool const is_wanted = (!set.mask || set.mask[i]) && sum < kInfinity;
  if (threadIdx.x % 32 == 0) set.half_squares[i] = is_wanted ? sum / 2 : kInfinity;
}

// Components [from, from + kDepth) of the descriptors [start, start + kTile), read by all threads; 0 where there is
// none.
struct TileReader {
  static constexpr int kElements = kTile * kDepth / kThreads;
  float const* at;
  int64_t stride;
  unsigned is_wanted;
  float next[kElements];

  __device__ __forceinline__ TileReader(DescriptorSet<float> const& set, int64_t b, int start, int width)
      : at(set.values + (b * set.count + start + int(threadIdx.x) / kDepth) * width + threadIdx.x % kDepth),
        stride(int64_t(kThreads / kDepth) * width),
        is_wanted(0) {
#pragma unroll
    for (int e = 0; e < kElements; ++e) {
      int const i = start + int(threadIdx.x) / kDepth + e * (kThreads / kDepth);
      if (i < set.count && set.half_squares[b * set.count + i] < kInfinity) is_wanted |= 1u << e;
    }
  }
  __device__ __forceinline__ void fetch(int from, int width) {
    bool const inside = from + int(threadIdx.x) % kDepth < width;
#pragma unroll
    for (int e = 0; e < kElements; ++e) next[e] = inside && (is_wanted >> e & 1) ? at[e * stride + from] : 0.f;
  }
  __device__ __forceinline__ void store(float (&tile)[kDepth][kTile + 4]) const {
#pragma unroll
    for (int e = 0; e < kElements; ++e)
      tile[threadIdx.x % kDepth][threadIdx.x / kDepth + e * (kThreads / kDepth)] = next[e];
  }
};

// A block a tile. A thread has 8 x 8 distances in registers, in groups of 4 adjacent ones; 16 components of the tile's
// descriptors are in shared memory at a time.
__global__ void __launch_bounds__(kThreads, 2) find_candidates(__grid_constant__ TwoNearest<float> const p) {
  DescriptorSet<float> const &first = p.first, &second = p.second;
  __shared__ __align__(16) float rows[kDepth][kTile + 4];
  __shared__ __align__(16) float columns[kDepth][kTile + 4];
  __shared__ Candidates of_columns[kWarps][kTile];

  unsigned const tiles1 = first.tiles(), tiles2 = second.tiles();
  int const tile2 = int(blockIdx.x % tiles2), tile1 = int(blockIdx.x / tiles2 % tiles1);
  int64_t const b = blockIdx.x / tiles2 / tiles1;
  int const tx = threadIdx.x % 16, ty = threadIdx.x / 16, start1 = tile1 * kTile, start2 = tile2 * kTile;

  float dot[R][R] = {};
  TileReader row_reader(first, b, start1, p.width), column_reader(second, b, start2, p.width);
  row_reader.fetch(0, p.width);
  column_reader.fetch(0, p.width);
  for (int from = 0; from < p.width; from += kDepth) {
    __syncthreads();
    row_reader.store(rows);
    column_reader.store(columns);
    __syncthreads();
    if (from + kDepth < p.width) {
      row_reader.fetch(from + kDepth, p.width);
      column_reader.fetch(from + kDepth, p.width);
    }
#pragma unroll
    for (int d = 0; d < kDepth; ++d) {
      float x[R], y[R];
#pragma unroll
      for (int i = 0; i < R; i += 4) {
        *reinterpret_cast<Vector<float, 4>*>(x + i) =
            *reinterpret_cast<Vector<float, 4> const*>(&rows[d][in_tile(ty, i)]);
        *reinterpret_cast<Vector<float, 4>*>(y + i) =
            *reinterpret_cast<Vector<float, 4> const*>(&columns[d][in_tile(tx, i)]);
      }
#pragma unroll
      for (int i = 0; i < R; ++i)
#pragma unroll
        for (int j = 0; j < R; ++j) dot[i][j] += x[i] * y[j];
    }
  }

  auto const half_square = [&](DescriptorSet<float> const& set, int i) {
    return i < set.count ? set.half_squares[b * set.count + i] : kInfinity;
  };
  float of_column[R];
#pragma unroll
  for (int j = 0; j < R; ++j) of_column[j] = half_square(second, start2 + in_tile(tx, j));
#pragma unroll
  for (int i = 0; i < R; ++i) {
    float const of_row = half_square(first, start1 + in_tile(ty, i));
#pragma unroll
    for (int j = 0; j < R; ++j) dot[i][j] = max(of_row + of_column[j] - dot[i][j], 0.f);
  }

  // Rows: 16 lanes of a warp have the same 8 rows; each keeps one of them.
  {
    Candidates lists[R], of4[4], of2[2], of1[1];
#pragma unroll
    for (int i = 0; i < R; ++i) {
      lists[i] = Candidates::none();
#pragma unroll
      for (int j = 0; j < R; ++j) insert(lists[i], candidate(dot[i][j], in_tile(tx, j)));
    }
    merge_halves<8>(lists, of4);
    merge_halves<4>(of4, of2);
    merge_halves<2>(of2, of1);
    Candidates others;
#pragma unroll
    for (int k = 0; k < 3; ++k) others.v[k] = __shfl_xor_sync(kAllLanes, of1[0].v[k], 1);
    int const row = start1 + in_tile(ty, tx / 2);
    if (tx % 2 == 0 && row < first.count)
      first.candidates[(b * first.count + row) * tiles2 + tile2] = merged(of1[0], others);
  }

  // Columns: two lanes of each of the 8 warps have the same 8 columns.
  if (second.candidates) {
    Candidates lists[R], of4[4];
#pragma unroll
    for (int j = 0; j < R; ++j) {
      lists[j] = Candidates::none();
#pragma unroll
      for (int i = 0; i < R; ++i) insert(lists[j], candidate(dot[i][j], in_tile(ty, i)));
    }
    merge_halves<16>(lists, of4);
#pragma unroll
    for (int j = 0; j < 4; ++j) of_columns[threadIdx.x / 32][in_tile(tx, j + threadIdx.x % 32 / 16 * 4)] = of4[j];
    __syncthreads();
    int const c = int(threadIdx.x);
    if (c < kTile && start2 + c < second.count) {
      Candidates list = of_columns[0][c];
#pragma unroll
      for (int w = 1; w < kWarps; ++w) list = merged(list, of_columns[w][c]);
      second.candidates[(b * second.count + start2 + c) * tiles1 + tile1] = list;
    }
  }
}

// Candidates of all tiles in order: the bits of half the squared distance, then the index.
constexpr int kListed = 5, kChecked = 4;
constexpr unsigned long long kNone = ~0ull;

__device__ __forceinline__ unsigned long long smallest_of_warp(unsigned long long x) {
  for (int lanes = 16; lanes > 0; lanes /= 2) {
    unsigned long long const other = __shfl_xor_sync(kAllLanes, x, lanes);
    x = other < x ? other : x;
  }
  return x;
}

struct MergeNeighbors {
  __device__ __forceinline__ Neighbors<float> operator()(Neighbors<float> a, Neighbors<float> const& b) const {
    a.merge(b);
    return a;
  }
};

// Descriptor i of a set of all samples, and the set that its neighbors are in.
struct Searched {
  DescriptorSet<float> const *own, *other;
  int64_t i, first_other;  // of its sample
  __device__ __forceinline__ Searched(TwoNearest<float> const& p, int64_t element) {
    int64_t const firsts = p.batch * p.first.count;
    bool const in_second = element >= firsts;
    own = in_second ? &p.second : &p.first, other = in_second ? &p.first : &p.second;
    i = in_second ? element - firsts : element;
    first_other = i / own->count * other->count;
  }
  __device__ __forceinline__ void store(Neighbors<float> const& neighbors) const {
    for (int k = 0; k < 2; ++k) {
      own->distances[2 * i + k] = sqrtf(neighbors.square[k]);
      own->indices[2 * i + k] = neighbors.index[k];
    }
  }
};

// The neighbors of a descriptor among the candidates of all tiles, found by a warp. False if there may be nearer ones.
__device__ __forceinline__ bool nearest_candidates(TwoNearest<float> const& p, Searched const& s,
                                                   Neighbors<float>& neighbors) {
  int const lane = threadIdx.x % 32, tiles = int(s.other->tiles());
  float const half_square = s.own->half_squares[s.i];
  neighbors = Neighbors<float>::none();
  if (!(half_square < kInfinity)) return true;
  unsigned long long list[kListed];
  for (int k = 0; k < kListed; ++k) list[k] = kNone;
  float unseen = kInfinity;
  for (int e = lane; e < 3 * tiles; e += 32) {
    int const tile = e / 3, v = s.own->candidates[s.i * tiles + tile].v[e % 3];
    if (e % 3 == 2) unseen = min(unseen, half_square_of(v));
    unsigned long long x =
        (unsigned long long)__float_as_uint(half_square_of(v)) << 32 | unsigned(tile * kTile + (v & int(kColumnBits)));
#pragma unroll
    for (int k = 0; k < kListed; ++k) {
      unsigned long long const larger = list[k] < x ? x : list[k];
      list[k] = list[k] < x ? list[k] : x, x = larger;
    }
  }
  unseen = warp_reduce(unseen, Min());
  int index[kChecked];
  for (int c = 0; c < kListed; ++c) {
    unsigned long long const smallest = smallest_of_warp(list[0]);
    float const value = __uint_as_float(unsigned(smallest >> 32));  // NaN for none
    if (c < kChecked)
      index[c] = value < kInfinity ? int(unsigned(smallest)) : -1;
    else if (value < unseen)
      unseen = value;
    if (list[0] == smallest) {
#pragma unroll
      for (int k = 0; k + 1 < kListed; ++k) list[k] = list[k + 1];
      list[kListed - 1] = kNone;
    }
  }
  float square[kChecked] = {};
  float const* const x = s.own->values + s.i * p.width;
  for (int d = lane; d < p.width; d += 32) {
    float const own = x[d];
#pragma unroll
    for (int c = 0; c < kChecked; ++c)
      if (index[c] >= 0) {
        float const difference = own - s.other->values[(s.first_other + index[c]) * p.width + d];
        square[c] += difference * difference;
      }
  }
#pragma unroll
  for (int c = 0; c < kChecked; ++c) {
    float const sum = warp_reduce(square[c], Sum());
    if (index[c] >= 0) neighbors.insert(sum, index[c]);
  }
  if (!(unseen < kInfinity)) return true;
  // The rounding of a product of vectors is at most width / 2 times that of a number of |a|^2 / 2 + |b|^2 / 2.
  // Descriptors b that are more than twice as long as a are as far away as a quarter of their share.
  float const rounding = 4 * float(p.width + 8) * __FLT_EPSILON__ * (half_square + unseen);
  return neighbors.square[1] / 2 <= unseen - rounding;
}

// A warp for each descriptor of both sets, then the block for those whose candidates do not suffice.
__global__ void __launch_bounds__(kThreads)
    choose_neighbors(__grid_constant__ TwoNearest<float> const p, int64_t elements) {
  __shared__ Neighbors<float> of_warps[kWarps];
  __shared__ bool suffice[kWarps];
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int64_t const first = blockIdx.x * int64_t(kWarps);
  {
    bool done = true;
    if (first + warp < elements) {
      Searched const s(p, first + warp);
      Neighbors<float> neighbors;
      done = nearest_candidates(p, s, neighbors);
      if (done && lane == 0) s.store(neighbors);
    }
    if (lane == 0) suffice[warp] = done;
  }
  __syncthreads();
  for (int w = 0; w < kWarps; ++w) {
    if (suffice[w]) continue;
    Searched const s(p, first + w);
    float const* const x = s.own->values + s.i * p.width;
    Neighbors<float> neighbors = Neighbors<float>::none();
    for (int j = threadIdx.x; j < s.other->count; j += kThreads) {
      if (!(s.other->half_squares[s.first_other + j] < kInfinity)) continue;
      float const* const y = s.other->values + (s.first_other + j) * p.width;
      float square = 0;
      for (int d = 0; d < p.width; ++d) square += (x[d] - y[d]) * (x[d] - y[d]);
      neighbors.insert(square, j);
    }
    neighbors = warp_reduce(neighbors, MergeNeighbors());
    if (lane == 0) of_warps[warp] = neighbors;
    __syncthreads();
    if (threadIdx.x == 0) {
      for (int k = 1; k < kWarps; ++k) neighbors.merge(of_warps[k]);
      s.store(neighbors);
    }
    __syncthreads();
  }
}

}  // namespace

int find_matching_candidates(TwoNearest<float> const& p, CUstream_st* stream) {
  int64_t const warps = p.batch * (int64_t(p.first.count) + p.second.count);
  half_squares<<<unsigned(ceil_div(warps, kWarps)), kThreads, 0, stream>>>(p);
  if (int const error = cudaGetLastError()) return error;
  int64_t const tiles = p.batch * p.first.tiles() * p.second.tiles();
  find_candidates<<<unsigned(tiles), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

int choose_matching_neighbors(TwoNearest<float> const& p, CUstream_st* stream) {
  int64_t const elements = p.batch * (int64_t(p.first.count) + (p.second.candidates ? p.second.count : 0));
  choose_neighbors<<<unsigned(ceil_div(elements, kWarps)), kThreads, 0, stream>>>(p, elements);
  return cudaGetLastError();
}

}  // namespace kv::feature::cuda
