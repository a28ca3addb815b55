// The two nearest descriptors on CUDA for float32, by tensor cores. A tile of pairs computes
// |a - b|^2 / 2 = |a|^2 / 2 + |b|^2 / 2 - a . b, where a and b are sums of two bfloat16, and keeps the three nearest
// candidates of each row and column. Then a warp for each descriptor computes the distances of the nearest candidates
// of all tiles as sums of squared differences. Other pairs of a tile have at least the distance of its third candidate.
// Where this bound, rounding included, does not exclude them, all distances of the tile are computed. Of small sets,
// one kernel computes all distances.
#include "core/launch.cuh"
#include "feature/matching.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32, kTile = kMatchingTile<float>;
constexpr unsigned kAllLanes = 0xffffffffu, kColumnBits = kTile - 1;
constexpr float kInfinity = __builtin_inff();
static_assert(kTile == 128);

// A candidate: half the squared distance, whose last bits are replaced by the row or column in the tile. The bits of
// non-negative floats, as integers, have the order of the floats.
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

// Merges the N lists of two lanes that differ in bit `Lane`. Each lane keeps half of the merged lists.
template <int Lane, int N>
__device__ __forceinline__ void merge_halves(Candidates (&lists)[N], Candidates (&kept)[N / 2]) {
  bool const is_upper = threadIdx.x & Lane;
#pragma unroll
  for (int i = 0; i < N / 2; ++i) {
    Candidates own, others;
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      own.v[k] = is_upper ? lists[i + N / 2].v[k] : lists[i].v[k];
      int const sent = is_upper ? lists[i].v[k] : lists[i + N / 2].v[k];
      others.v[k] = shuffle_xor(sent, Lane);
    }
    kept[i] = merged(own, others);
  }
}

// Computes half of the squared length, inf for masked and non-finite descriptors, and splits the components into two
// bfloat16: 32 first summands, then their 32 second summands, padded with zeros. A warp for each descriptor of both
// sets.
__global__ void __launch_bounds__(kThreads) split_descriptors(__grid_constant__ TwoNearest<float> const p) {
  int64_t const warp = blockIdx.x * int64_t(kWarps) + threadIdx.x / 32, firsts = p.batch * p.first.count;
  bool const in_second = warp >= firsts;
  DescriptorSet<float> const& set = in_second ? p.second : p.first;
  int64_t const i = in_second ? warp - firsts : warp;
  if (i >= p.batch * set.count) return;
  int const lane = threadIdx.x % 32;
  float const* const x = set.values + i * p.width;
  float sum = 0;
  for (int d = lane; d < p.width; d += 32) sum += x[d] * x[d];
  sum = warp_reduce(sum, Sum());
  bool const is_valid = (!set.mask || set.mask[i]) && sum < kInfinity;
  if (lane == 0) set.half_squares[i] = is_valid ? sum / 2 : kInfinity;
  BFloat16* const to = set.split + i * split_width(p.width);
  for (int d = lane; 2 * d < split_width(p.width); d += 32) {
    float const component = is_valid && d < p.width ? x[d] : 0.f;
    BFloat16 const coarse = round_to_bfloat16(component);
    to[2 * (d - lane) + lane] = coarse;
    to[2 * (d - lane) + 32 + lane] = round_to_bfloat16(component - read(coarse));
  }
}

// 32 components of the descriptors of a tile in shared memory, two in a word. The pitch of 20 words and the distance of
// 16 banks between first and second summands avoid bank conflicts.
struct SharedTile {
  static constexpr int kRow = 20, kPart = kTile * kRow + 16;
  unsigned words[2 * kPart];

  __device__ __forceinline__ void load(DescriptorSet<float> const& set, int64_t b, int start, int from, int width) {
    int const vector = threadIdx.x % 8;
#pragma unroll
    for (int e = 0; e < kTile / 32; ++e) {
      int const row = threadIdx.x / 8 + 32 * e, i = start + row;
      uint4 values{};
      if (i < set.count)
        values =
            reinterpret_cast<uint4 const*>(set.split + (b * set.count + i) * split_width(width) + 2 * from)[vector];
      *reinterpret_cast<uint4*>(words + vector / 4 * kPart + row * kRow + vector % 4 * 4) = values;
    }
  }
};

// c += a b, for 16 x 16 and 16 x 8 numbers of a warp.
__device__ __forceinline__ void add_product(float (&c)[4], unsigned const (&a)[4], unsigned const (&b)[2]) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  asm("mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, "
      "%3};"
      : "+f"(c[0]), "+f"(c[1]), "+f"(c[2]), "+f"(c[3])
      : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
#endif
}

// One block per tile. A warp has 64 x 32 pairs of it, and a thread 8 x 8: rows 8 i + lane / 4, and columns
// 8 (j / 2) + 2 (lane % 4) + j % 2.
__global__ void __launch_bounds__(kThreads, 2) find_candidates(__grid_constant__ TwoNearest<float> const p) {
  DescriptorSet<float> const &first = p.first, &second = p.second;
  constexpr int kRowWarps = 2, kColumnWarps = 4;
  union Memory {
    SharedTile tiles[2];
    struct {
      Candidates of_rows[kColumnWarps][kTile], of_columns[kRowWarps][kTile];
    } merged;
    __device__ Memory() {}
  };
  __shared__ __align__(16) Memory memory;

  unsigned const tiles1 = first.tiles(), tiles2 = second.tiles();
  int const tile2 = int(blockIdx.x % tiles2), tile1 = int(blockIdx.x / tiles2 % tiles1);
  int64_t const b = blockIdx.x / tiles2 / tiles1;
  int const warp = threadIdx.x / 32, g = threadIdx.x % 32 / 4, t = threadIdx.x % 4;
  int const row0 = warp / kColumnWarps * 64 + g, column0 = warp % kColumnWarps * 32;
  int const start1 = tile1 * kTile, start2 = tile2 * kTile;

  float products[4][4][4] = {};
  for (int from = 0; from < p.width; from += 32) {
    __syncthreads();
    memory.tiles[0].load(first, b, start1, from, p.width);
    memory.tiles[1].load(second, b, start2, from, p.width);
    __syncthreads();
    unsigned const* const rows = memory.tiles[0].words + row0 * SharedTile::kRow + t;
    unsigned const* const columns = memory.tiles[1].words + (column0 + g) * SharedTile::kRow + t;
#pragma unroll
    for (int k = 0; k < 16; k += 8) {  // words of 16 components
      unsigned y[2][4][2];
#pragma unroll
      for (int part = 0; part < 2; ++part)
#pragma unroll
        for (int n = 0; n < 4; ++n)
#pragma unroll
          for (int half = 0; half < 2; ++half)
            y[part][n][half] = columns[part * SharedTile::kPart + 8 * n * SharedTile::kRow + k + 4 * half];
#pragma unroll
      for (int m = 0; m < 4; ++m) {
        unsigned x[2][4];
#pragma unroll
        for (int part = 0; part < 2; ++part)
#pragma unroll
          for (int e = 0; e < 4; ++e)
            x[part][e] = rows[part * SharedTile::kPart + (16 * m + e % 2 * 8) * SharedTile::kRow + k + e / 2 * 4];
#pragma unroll
        for (int n = 0; n < 4; ++n) {
          add_product(products[m][n], x[0], y[1][n]);
          add_product(products[m][n], x[1], y[0][n]);
          add_product(products[m][n], x[0], y[0][n]);
        }
      }
    }
  }
  __syncthreads();  // before `merged` replaces the tiles

  auto const half_square = [&](DescriptorSet<float> const& set, int i) {
    return i < set.count ? set.half_squares[b * set.count + i] : kInfinity;
  };
  auto const row_of = [&](int i) { return row0 + 8 * i; };
  auto const column_of = [&](int j) { return column0 + j / 2 * 8 + 2 * t + j % 2; };
  float half_squares[8][8], of_column[8];
#pragma unroll
  for (int j = 0; j < 8; ++j) of_column[j] = half_square(second, start2 + column_of(j));
#pragma unroll
  for (int i = 0; i < 8; ++i) {
    float const of_row = half_square(first, start1 + row_of(i));
#pragma unroll
    for (int j = 0; j < 8; ++j)
      half_squares[i][j] = max(of_row + of_column[j] - products[i / 2][j / 2][i % 2 * 2 + j % 2], 0.f);
  }

  {  // four lanes have the same rows
    Candidates lists[8], of4[4], of2[2];
#pragma unroll
    for (int i = 0; i < 8; ++i) {
      lists[i] = Candidates::none();
#pragma unroll
      for (int j = 0; j < 8; ++j) insert(lists[i], candidate(half_squares[i][j], column_of(j)));
    }
    merge_halves<1>(lists, of4);
    merge_halves<2>(of4, of2);
    int const i = t % 2 * 4 + t / 2 * 2;
    memory.merged.of_rows[warp % kColumnWarps][row_of(i)] = of2[0];
    memory.merged.of_rows[warp % kColumnWarps][row_of(i + 1)] = of2[1];
  }
  if (second.candidates) {  // eight lanes have the same columns
    Candidates lists[8], of4[4], of2[2], of1[1];
#pragma unroll
    for (int j = 0; j < 8; ++j) {
      lists[j] = Candidates::none();
#pragma unroll
      for (int i = 0; i < 8; ++i) insert(lists[j], candidate(half_squares[i][j], row_of(i)));
    }
    merge_halves<4>(lists, of4);
    merge_halves<8>(of4, of2);
    merge_halves<16>(of2, of1);
    memory.merged.of_columns[warp / kColumnWarps][column_of(g % 2 * 4 + g / 2 % 2 * 2 + g / 4)] = of1[0];
  }
  __syncthreads();
  int const at = int(threadIdx.x) % kTile;
  if (threadIdx.x < kTile) {
    if (start1 + at < first.count) {
      Candidates list = memory.merged.of_rows[0][at];
#pragma unroll
      for (int w = 1; w < kColumnWarps; ++w) list = merged(list, memory.merged.of_rows[w][at]);
      first.candidates[(b * first.count + start1 + at) * tiles2 + tile2] = list;
    }
  } else if (second.candidates && start2 + at < second.count) {
    Candidates const list = merged(memory.merged.of_columns[0][at], memory.merged.of_columns[1][at]);
    second.candidates[(b * second.count + start2 + at) * tiles1 + tile1] = list;
  }
}

// A key that sorts candidates of all tiles: the bits of half the squared distance, then the index.
__device__ __forceinline__ unsigned long long ranked(int candidate, int tile) {
  return (unsigned long long)__float_as_uint(half_square_of(candidate)) << 32 |
         unsigned(tile * kTile + (candidate & int(kColumnBits)));
}

// The search of a warp for the neighbors of one descriptor.
struct Search {
  DescriptorSet<float> const *own, *other;
  int64_t i, first_other;  // the index of the descriptor, and of the first one of its sample in the other set
  int width;
  Neighbors<float> neighbors = Neighbors<float>::none();

  __device__ __forceinline__ Search(TwoNearest<float> const& p, int64_t element) : width(p.width) {
    int64_t const firsts = p.batch * p.first.count;
    bool const in_second = element >= firsts;
    own = in_second ? &p.second : &p.first, other = in_second ? &p.first : &p.second;
    i = in_second ? element - firsts : element;
    first_other = i / own->count * other->count;
  }
  // Inserts N descriptors of the other set, from j on, by their exact distances.
  template <int N>
  __device__ __forceinline__ void add(int j) {
    float const *const x = own->values + i * width, *const y = other->values + (first_other + j) * width;
    float squares[N] = {};
    for (int d = threadIdx.x % 32; d < width; d += 32) {
      float const component = x[d];
#pragma unroll
      for (int n = 0; n < N; ++n) {
        float const difference = component - y[int64_t(n) * width + d];
        squares[n] += difference * difference;
      }
    }
#pragma unroll
    for (int n = 0; n < N; ++n) {
      float const square = warp_reduce(squares[n], Sum());
      bool const is_new = j + n != neighbors.index[0] && j + n != neighbors.index[1];
      if (is_new && other->half_squares[first_other + j + n] < kInfinity) neighbors.insert(square, j + n);
    }
  }
  __device__ __forceinline__ void store() const { store_neighbors(*own, i, i % own->count, neighbors); }
  __device__ __forceinline__ void add_tile(int tile) {
    constexpr int kUnroll = 8;
    int const from = tile * kTile, to = min(from + kTile, other->count);
    int j = from;
    for (; j + kUnroll <= to; j += kUnroll) add<kUnroll>(j);
    for (; j < to; ++j) add<1>(j);
  }
};

// A warp for each descriptor of both sets. The exact distances of the two nearest candidates of all tiles bound those
// of the neighbors. Candidates within the bound are computed too, and whole tiles whose third candidate is within it.
__global__ void __launch_bounds__(kThreads)
    choose_neighbors(__grid_constant__ TwoNearest<float> const p, int64_t elements) {
  int const lane = threadIdx.x % 32;
  int64_t const element = blockIdx.x * int64_t(kWarps) + threadIdx.x / 32;
  if (element >= elements) return;
  Search search(p, element);
  int const tiles = int(search.other->tiles());
  Candidates const* const candidates = search.own->candidates + search.i * tiles;
  float const half_square = search.own->half_squares[search.i];
  if (half_square < kInfinity) {
    unsigned long long first = ~0ull, second = ~0ull;
    for (int tile = lane; tile < tiles; tile += 32) {
      Candidates const list = candidates[tile];
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        unsigned long long const x = ranked(list.v[k], tile), later = first < x ? x : first;
        first = first < x ? first : x, second = second < later ? second : later;
      }
    }
    unsigned long long const nearest = warp_reduce(first, Min());
    unsigned long long const next = warp_reduce(first == nearest ? second : first, Min());
    auto const add = [&](unsigned long long x) {
      if (__uint_as_float(unsigned(x >> 32)) < kInfinity) search.add<1>(int(unsigned(x)));
    };
    add(nearest), add(next);

    // Relative to |a|^2 / 2 + |b|^2 / 2, a product of vectors that are sums of two bfloat16 loses at most 2^-16, and
    // its sum in float32 less than width 2^-23. The distance of a descriptor b that is more than twice as long as
    // a is at least a quarter of |b|^2 / 2. The squares that are compared are rounded as well.
    float const rounding = 0x1p-13f + 4 * float(p.width + 8) * __FLT_EPSILON__;
    float const farthest = (search.neighbors.square[1] / 2 + rounding * half_square) * (1 + 2 * rounding);
    for (int start = 0; start < tiles; start += 32) {
      Candidates list = Candidates::none();
      if (start + lane < tiles) list = candidates[start + lane];
      auto const may_be_near = [&](int k) {  // none is NaN
        float const value = half_square_of(list.v[k]);
        return value < kInfinity && value <= farthest;
      };
      for (unsigned all = __ballot_sync(kAllLanes, may_be_near(2)); all; all &= all - 1)
        search.add_tile(start + __ffs(int(all)) - 1);
#pragma unroll
      for (int k = 0; k < 2; ++k)
        for (unsigned some = __ballot_sync(kAllLanes, may_be_near(k) && !may_be_near(2)); some; some &= some - 1) {
          int const from = __ffs(int(some)) - 1;
          search.add<1>((start + from) * kTile + (__shfl_sync(kAllLanes, list.v[k], from) & int(kColumnBits)));
        }
    }
  }
  if (lane == 0) search.store();
}

// --- small sets ------------------------------------------------------------------------------------------------------

constexpr int kGroup = 8;  // descriptors of the other set that a warp compares at a time

struct MergeNeighbors {
  __device__ __forceinline__ Neighbors<float> operator()(Neighbors<float> a, Neighbors<float> const& b) const {
    a.merge(b);
    return a;
  }
};

// Adds up N values over the lanes that differ in bits up to `Lane`. A lane gets one of the sums, which its bits select.
// They are the same bits as those of warp_reduce.
template <int Lane, int N>
__device__ __forceinline__ float sum_over_lanes(float const (&values)[N]) {
  if constexpr (N == 1) {
    return warp_reduce<2 * Lane>(values[0], Sum());
  } else {
    bool const is_upper = threadIdx.x & Lane;
    float sums[N / 2];
#pragma unroll
    for (int i = 0; i < N / 2; ++i) {
      float const own = is_upper ? values[i + N / 2] : values[i];
      sums[i] = own + shuffle_xor(is_upper ? values[i] : values[i + N / 2], Lane);
    }
    return sum_over_lanes<Lane / 2>(sums);
  }
}

// A block for each descriptor of both sets. Its warps compare it with all of the other set, and add up squares in the
// order of split_descriptors and Search::add, so that results are those of larger sets.
__global__ void __launch_bounds__(kThreads) find_neighbors(__grid_constant__ TwoNearest<float> const p) {
  __shared__ Neighbors<float> of_warps[kWarps];
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  Search search(p, blockIdx.x);
  float const* const x = search.own->values + search.i * p.width;
  float const* const others = search.other->values + search.first_other * p.width;
  bool const *const own_mask = search.own->mask, *const mask = search.other->mask;
  int const count = search.other->count;
  float length = 0;
  for (int d = lane; d < p.width; d += 32) length += x[d] * x[d];
  length = warp_reduce(length, Sum());
  if ((!own_mask || own_mask[search.i]) && length < kInfinity)
    for (int start = warp * kGroup; start < count; start += kWarps * kGroup) {
      float squares[kGroup] = {}, lengths[kGroup] = {};
#pragma unroll 4  // so that the loads of several components are in flight
      for (int d = lane; d < p.width; d += 32) {
        float const component = x[d];
#pragma unroll
        for (int n = 0; n < kGroup; ++n) {
          float const value = others[int64_t(min(start + n, count - 1)) * p.width + d], difference = component - value;
          squares[n] += difference * difference, lengths[n] += value * value;
        }
      }
      float const square = sum_over_lanes<16>(squares), other_length = sum_over_lanes<16>(lengths);
      int const j = start + (lane & 16) / 4 + (lane & 8) / 4 + (lane & 4) / 4;
      if (j < count && (!mask || mask[search.first_other + j]) && other_length < kInfinity)
        search.neighbors.insert(square, j);
    }
  search.neighbors = warp_reduce<32, 4>(search.neighbors, MergeNeighbors());
  if (lane == 0) of_warps[warp] = search.neighbors;
  __syncthreads();
  if (threadIdx.x != 0) return;
#pragma unroll
  for (int w = 1; w < kWarps; ++w) search.neighbors.merge(of_warps[w]);
  search.store();
}

}  // namespace

bool has_matching_candidates() {
  int device = 0, major = 0;
  cudaGetDevice(&device);
  cudaDeviceGetAttribute(&major, cudaDevAttrComputeCapabilityMajor, device);
  return major >= 8;
}

int find_matching_candidates(TwoNearest<float> const& p, CUstream_st* stream) {
  int64_t const warps = p.batch * (int64_t(p.first.count) + p.second.count);
  split_descriptors<<<unsigned(ceil_div(warps, kWarps)), kThreads, 0, stream>>>(p);
  if (int const error = cudaGetLastError()) return error;
  int64_t const tiles = p.batch * p.first.tiles() * p.second.tiles();
  find_candidates<<<unsigned(tiles), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

int choose_matching_neighbors(TwoNearest<float> const& p, CUstream_st* stream) {
  int64_t const elements = p.batch * (int64_t(p.first.count) + (p.both ? p.second.count : 0));
  choose_neighbors<<<unsigned(ceil_div(elements, kWarps)), kThreads, 0, stream>>>(p, elements);
  return cudaGetLastError();
}

int find_matching_neighbors(TwoNearest<float> const& p, CUstream_st* stream) {
  int64_t const elements = p.batch * (int64_t(p.first.count) + (p.both ? p.second.count : 0));
  find_neighbors<<<unsigned(elements), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::feature::cuda
