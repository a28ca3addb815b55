// Histogram equalization on CUDA. A plane of up to half a million pixels is read once: the blocks of a cluster, or one
// block, count its levels, keep them as bytes in shared memory and map them with the table. Larger planes are counted
// by several blocks and read again. A block of a list finds its sample in the table.
#include "byte_histogram.cuh"
#include "core/cluster.cuh"
#include "core/stencils/filter_list.cuh"
#include "core/stencils/gradient_list.cuh"
#include "equalize.h"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 384;
using Counter = LevelCounter<8>;
constexpr int kCountBytes = Counter::kSize * int(sizeof(int32_t));
template <class T>
constexpr int kBlocks = sizeof(T) == 8 ? 2 : 3;  // per multiprocessor

// Pixels of a block, at most: 227 KiB of shared memory are enough for three blocks then.
constexpr int64_t kMaxPixels = (64 << 10) + 64;

// The table from level to value, in as many copies as fit the memory of the counts. Bytes are values of four levels in
// a word, with a copy for each thread of a warp: they read different banks.
template <class T>
struct Table {
  static constexpr bool kBytes = sizeof(T) == 1;
  using Value = std::conditional_t<kBytes, uint8_t, Compute<T>>;
  static constexpr int kTables = kCountBytes / (kLevels * int(sizeof(Value)));
  static_assert(!kBytes || kTables == 32);
  Value const* values;
  __device__ __forceinline__ Value operator[](int level) const {
    if constexpr (kBytes)
      return values[(level & ~3) * kTables + (level & 3) + 4 * int(threadIdx.x % kTables)];
    else
      return values[level * kTables + threadIdx.x % kTables];
  }
  static __device__ __forceinline__ Value unchanged(T pixel) {
    if constexpr (kBytes)
      return pixel;
    else
      return read(pixel);
  }
  // Thread `level` writes the copies of its value.
  static __device__ __forceinline__ void write(void* memory, int level, int mapped) {
    if constexpr (kBytes) {
      auto* const words = static_cast<uint32_t*>(memory) + level / 4 * kTables;
      uint32_t four = uint32_t(mapped) << level % 4 * 8;
      four |= __shfl_xor_sync(0xffffffffu, four, 1);
      four |= __shfl_xor_sync(0xffffffffu, four, 2);
#pragma unroll
      for (int i = 0; i < kTables / 4; ++i) words[(i * 4 + level + level / 4) % kTables] = four;
    } else {
      constexpr int kEach = 16 / sizeof(Value), kVectors = kTables / kEach;
      Vector<Value, kEach> copies;
#pragma unroll
      for (Value& copy : copies.v) copy = Value(mapped) / 255;
      auto* const vectors = static_cast<Vector<Value, kEach>*>(memory) + level * kVectors;
      int const first = level * kVectors / 8;  // threads with adjacent levels write to different banks at a time
#pragma unroll
      for (int i = 0; i < kVectors; ++i) vectors[(first + i) & (kVectors - 1)] = copies;
    }
  }
};

template <class T, int N>
__device__ __forceinline__ void store_values(T* to, typename Table<T>::Value const (&v)[N]) {
  if constexpr (sizeof(T) == 1) {
    Vector<T, N> vector;
#pragma unroll
    for (int k = 0; k < N; ++k) vector.v[k] = v[k];
    store_vector(to, vector);
  } else {
    store_vector(to, v);
  }
}

// The count of a level in all parts of a plane, of that of a block's part; thread i < kLevels has level i. Parts are
// the blocks of a cluster, which must wait for it once more before they end, as they read each other's totals.
__device__ __forceinline__ int count_of_plane(int count, int32_t (&totals)[kLevels], unsigned parts) {
  if (parts <= 1) return count;
  int const t = int(threadIdx.x);
  if (t < kLevels) totals[t] = count;
  cluster_arrive();
  cluster_wait();
  count = 0;
  for (unsigned rank = 0; t < kLevels && rank < parts; ++rank) count += load_of_block(&totals[t], rank);
  cluster_arrive();
  return count;
}

// Builds the table in `memory` from the counts; thread i < kLevels has the count of level i. False if the plane stays
// unchanged.
template <class Table>
__device__ __forceinline__ bool make_table(int count, bool opencv, void* memory, int& total) {
  __shared__ int darkest, brightest;
  int const level = threadIdx.x;
  if (level == 0) darkest = brightest = 0;
  if (level >= kLevels) count = 0;
  int const up_to = block_inclusive_scan<kThreads>(count, total);
  if (count > 0 && up_to == count) darkest = count;  // all darker levels are empty
  if (count > 0 && up_to == total) brightest = count;
  __syncthreads();
  Curve const curve{opencv, total, darkest, brightest};
  if (level < kLevels && curve.changes()) Table::write(memory, level, curve(up_to, count));
  __syncthreads();
  return curve.changes();
}

// Maps the pixels [begin, end) of a plane; without a table, copies them.
template <int P, class T>
__device__ __forceinline__ void map_pixels(Equalize<T> const& p, int64_t plane, int begin, int end, bool has_table,
                                           Table<T> table) {
  T* const y = p.y.plane(plane);
  for_each_vector<kThreads, P>(p.x.plane(plane), p.x.step, begin, end, [&](auto const& vector, int i) {
    constexpr int N = sizeof(vector) / sizeof(T);
    typename Table<T>::Value v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) {
      int const level = level_of(vector.v[k]);
      v[k] = has_table && level < kLevels ? table[level] : Table<T>::unchanged(vector.v[k]);
    }
    store_values(y + i * p.y.step, v);
  });
}

template <class T>
__device__ __forceinline__ T change_of_plane(bool changes, bool has_nan) {
  return round_to<T>(Compute<T>(int(!changes ? Change::none : has_nan ? Change::but_nan : Change::all)));
}

// A block processes `each` pixels of a plane, and a cluster of `parts` blocks the whole plane.
template <int P, class T>
__device__ __forceinline__ void equalize_part(Equalize<T> const& p, unsigned block, unsigned parts, int each) {
  extern __shared__ __align__(16) unsigned char memory[];
  __shared__ int32_t totals[kLevels];
  Counter const counter{reinterpret_cast<int32_t*>(memory)};
  unsigned const plane = block / parts, part = block - plane * parts;
  T const* const x = p.x.plane(plane);
  int const begin = int(part) * each, end = min(begin + each, int(p.x.width)), t = int(threadIdx.x);
  AlignedBody<P, int> const body(x, begin, end);
  unsigned char* const levels = memory + kCountBytes + P - body.begin;  // of pixel 0; vectors of levels are aligned

  counter.clear<kThreads>();
  __syncthreads();
  bool has_nan = false;
  for_each_vector<kThreads, P>(x, p.x.step, begin, end, [&](auto const& vector, int i) {
    constexpr int N = sizeof(vector) / sizeof(T);
    Vector<unsigned char, N> bytes;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      int const level = level_of(vector.v[k]);
      counter.add(level);
      has_nan = has_nan || (sizeof(T) > 1 && level == kNanLevel);
      if constexpr (sizeof(T) > 1) bytes.v[k] = static_cast<unsigned char>(level);
    }
    if constexpr (sizeof(T) == 1) __builtin_memcpy(&bytes, &vector, N);
    *reinterpret_cast<Vector<unsigned char, N>*>(levels + i) = bytes;
  });
  has_nan = __syncthreads_or(has_nan);
  int const count = count_of_plane(t < kLevels ? counter[t] : 0, totals, parts);
  __syncthreads();
  int counted;
  bool const changes = make_table<Table<T>>(count, p.opencv, memory, counted);
  Table<T> const table{reinterpret_cast<typename Table<T>::Value*>(memory)};
  if (part == 0 && t == 0) p.changed[plane] = change_of_plane<T>(changes, counted < p.x.width);

  if (has_nan || !changes) {  // a byte cannot represent NaN
    map_pixels<P>(p, plane, begin, end, changes, table);
  } else {
    T* const y = p.y.plane(plane);
    auto const map = [&](int i, auto size) {
      constexpr int N = size.value;
      auto const bytes = *reinterpret_cast<Vector<unsigned char, N> const*>(levels + i);
      typename Table<T>::Value v[N];
#pragma unroll
      for (int k = 0; k < N; ++k) v[k] = table[bytes.v[k]];
      store_values(y + i * p.y.step, v);
    };
    body.for_each_peeled([&](int i) { map(i, std::integral_constant<int, 1>{}); });
    for (int i = body.begin + t * P; i < body.end; i += kThreads * P) map(i, std::integral_constant<int, P>{});
  }
  if (parts > 1) cluster_wait();
}

// --- bytes in registers ----------------------------------------------------------------------------------------------

// A counter, and later a value, of each level for each thread of a warp: 128 bytes a level, so that no two threads use
// a bank. Places are addresses, computed by multiplication, since other instructions take all of the issue slots.
struct ByteLanes {
  uint32_t* const words;
  uint32_t const first;  // the address of the thread's word of level 0
  uint32_t level_bytes;

  explicit __device__ __forceinline__ ByteLanes(uint32_t* words)
      : words(words), first(uint32_t(__cvta_generic_to_shared(words + threadIdx.x % 32))) {
    asm("mov.u32 %0, 128;" : "=r"(level_bytes));  // a constant would become a shift and an addition
  }
  __device__ __forceinline__ uint32_t place(uint32_t level) const { return level * level_bytes + first; }
  __device__ __forceinline__ void add(uint32_t level) const {
    asm volatile("red.shared.add.u32 [%0], 1;" ::"r"(place(level)) : "memory");
  }
  __device__ __forceinline__ uint32_t operator[](uint32_t level) const {
    uint32_t value;
    asm volatile("ld.shared.u32 %0, [%1];" : "=r"(value) : "r"(place(level)));
    return value;
  }
  __device__ __forceinline__ int count_of(int level) const {
    auto const* const vectors = reinterpret_cast<int4 const*>(words + 32 * level);
    int sum = 0;
#pragma unroll
    for (int i = 0; i < 8; ++i) {
      int4 const four = vectors[(i + level) % 8];  // threads with adjacent levels read different banks at a time
      sum += four.x + four.y + four.z + four.w;
    }
    return sum;
  }
  static __device__ __forceinline__ void write(void* memory, int level, int mapped) {
    auto* const vectors = static_cast<uint4*>(memory) + 8 * level;
    uint32_t const value = mapped;
#pragma unroll
    for (int i = 0; i < 8; ++i) vectors[(i + level) % 8] = make_uint4(value, value, value, value);
  }
};

constexpr int kByteVectors = 8;                                       // of 16 bytes, that a thread keeps
constexpr int64_t kMaxBytes = int64_t(kByteVectors) * 16 * kThreads;  // of a block

// As equalize_part, for bytes, which stay in registers.
__device__ __forceinline__ void equalize_bytes_part(Equalize<uint8_t> const& p, unsigned block, unsigned parts,
                                                    int each) {
  __shared__ __align__(128) uint32_t memory[32 * kLevels];
  __shared__ int32_t totals[kLevels];
  unsigned const plane = block / parts, part = block - plane * parts;
  uint8_t const* const x = p.x.plane(plane);
  uint8_t* const y = p.y.plane(plane);
  int const begin = int(part) * each, end = min(begin + each, int(p.x.width)), t = int(threadIdx.x);
  ByteLanes const lanes(memory);
  auto const byte_of = [](uint32_t four, int k) { return __byte_perm(four, 0, 0x4440 + k); };
  AlignedBody<16, int> const body(x, begin, end);
  auto const vector_at = [&](int i) { return body.begin + (i * kThreads + t) * 16; };

  Vector<uint32_t, 4> vectors[kByteVectors];
#pragma unroll
  for (int i = 0; i < kByteVectors; ++i)
    if (vector_at(i) < body.end) vectors[i] = *reinterpret_cast<Vector<uint32_t, 4> const*>(x + vector_at(i));
#pragma unroll
  for (int first = 0; first < 8 * kLevels; first += kThreads)
    if (first + t < 8 * kLevels) reinterpret_cast<int4*>(memory)[first + t] = int4{};
  __syncthreads();
  body.for_each_peeled([&](int i) { lanes.add(x[i]); });
#pragma unroll
  for (int i = 0; i < kByteVectors; ++i) {
    if (vector_at(i) >= body.end) break;
#pragma unroll
    for (int k = 0; k < 16; ++k) lanes.add(byte_of(vectors[i].v[k / 4], k % 4));
  }
  __syncthreads();
  int const count = count_of_plane(t < kLevels ? lanes.count_of(t) : 0, totals, parts);
  int counted;  // make_table waits for all threads before it writes
  bool const changes = make_table<ByteLanes>(count, p.opencv, memory, counted);
  if (part == 0 && t == 0) p.changed[plane] = change_of_plane<uint8_t>(changes, false);

  body.for_each_peeled([&](int i) { y[i] = changes ? uint8_t(lanes[x[i]]) : x[i]; });
#pragma unroll
  for (int i = 0; i < kByteVectors; ++i) {
    if (vector_at(i) >= body.end) break;
    Vector<uint8_t, 16> mapped;
    if (changes) {
      uint32_t words[4];
#pragma unroll
      for (int k = 0; k < 4; ++k) {
        auto const value = [&](int n) { return lanes[byte_of(vectors[i].v[k], n)]; };
        words[k] =
            __byte_perm(__byte_perm(value(0), value(1), 0x0040), __byte_perm(value(2), value(3), 0x0040), 0x5410);
      }
      __builtin_memcpy(&mapped, words, 16);
    } else {
      __builtin_memcpy(&mapped, &vectors[i], 16);
    }
    store_vector(y + vector_at(i), mapped);
  }
  if (parts > 1) cluster_wait();
}

// Pixels of a plane that each of the blocks of a cluster processes.
KV_HD int pixels_of_part(int64_t pixels, unsigned parts) {
  return int(ceil_div(ceil_div(pixels, int64_t(parts)), int64_t(16)) * 16);
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads, kBlocks<T>) equalize_parts(Equalize<T> p, unsigned parts, int each) {
  equalize_part<P>(p, blockIdx.x, parts, each);
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads, kBlocks<T>)
    equalize_parts_of_list(__grid_constant__ EqualizeList<T> const p, unsigned parts) {
  unsigned block;
  Equalize<T> const* const one = sample_of_block(p, block);  // the same one for the blocks of a cluster
  if (!one) return;
  Equalize<T> const flat = flat_sample(*one);
  equalize_part<P>(flat, block, parts, pixels_of_part(flat.x.width, parts));
}

__global__ void __launch_bounds__(kThreads, kBlocks<uint8_t>)
    equalize_bytes(Equalize<uint8_t> p, unsigned parts, int each) {
  equalize_bytes_part(p, blockIdx.x, parts, each);
}
__global__ void __launch_bounds__(kThreads, kBlocks<uint8_t>)
    equalize_bytes_of_list(__grid_constant__ EqualizeList<uint8_t> const p, unsigned parts) {
  unsigned block;
  Equalize<uint8_t> const* const one = sample_of_block(p, block);
  if (!one) return;
  Equalize<uint8_t> const flat = flat_sample(*one);
  equalize_bytes_part(flat, block, parts, pixels_of_part(flat.x.width, parts));
}

// --- chunks ----------------------------------------------------------------------------------------------------------

// Chunks of planes, `each` pixels per block.
template <int P, class T>
__device__ __forceinline__ void count_chunk(Equalize<T> const& p, unsigned block, unsigned chunks, int each) {
  __shared__ __align__(16) int32_t counts[Counter::kSize];
  Counter const counter{counts};
  unsigned const plane = block / chunks;
  int64_t const begin = int64_t(block % chunks) * each;
  int const end = int(min(begin + each, p.x.width));
  counter.clear<kThreads>();
  __syncthreads();
  for_each_vector<kThreads, P>(p.x.plane(plane), p.x.step, int(begin), end, [&](auto const& vector, int) {
#pragma unroll
    for (T const x : vector.v) counter.add(level_of(x));
  });
  __syncthreads();
  if (threadIdx.x < kLevels) atomicAdd(p.counts + int64_t(plane) * kLevels + threadIdx.x, counter[threadIdx.x]);
}

template <int P, class T>
__device__ __forceinline__ void map_chunk(Equalize<T> const& p, unsigned block, unsigned chunks, int each) {
  __shared__ __align__(16) unsigned char memory[kCountBytes];
  unsigned const plane = block / chunks;
  int64_t const begin = int64_t(block % chunks) * each;
  int const count = threadIdx.x < kLevels ? p.counts[int64_t(plane) * kLevels + threadIdx.x] : 0;
  int counted;
  bool const changes = make_table<Table<T>>(count, p.opencv, memory, counted);
  if (begin == 0 && threadIdx.x == 0) p.changed[plane] = change_of_plane<T>(changes, counted < p.x.width);
  map_pixels<P>(p, plane, int(begin), int(min(begin + each, p.x.width)), changes,
                Table<T>{reinterpret_cast<typename Table<T>::Value*>(memory)});
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads, kBlocks<T>) count_levels(Equalize<T> p, unsigned chunks, int each) {
  count_chunk<P>(p, blockIdx.x, chunks, each);
}
template <class T, int P>
__global__ void __launch_bounds__(kThreads, kBlocks<T>) map_levels(Equalize<T> p, unsigned chunks, int each) {
  map_chunk<P>(p, blockIdx.x, chunks, each);
}

// The first or the second pass over the planes of a list.
template <class T, int P, bool Maps>
__global__ void __launch_bounds__(kThreads, kBlocks<T>)
    equalize_chunks_of_list(__grid_constant__ EqualizeList<T> const p, int each) {
  unsigned block;
  Equalize<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  Equalize<T> const flat = flat_sample(*one);
  unsigned const chunks = unsigned(ceil_div(flat.x.width, int64_t(each)));
  if constexpr (Maps)
    map_chunk<P>(flat, block, chunks, each);
  else
    count_chunk<P>(flat, block, chunks, each);
}

// The gradient is read only where it passes: nowhere, for most planes.
template <int P, class T>
__device__ __forceinline__ void gradients_of_chunk(EqualizeBackward<T> const& p, unsigned block, unsigned chunks,
                                                   int each) {
  using F = Compute<T>;
  unsigned const plane = block / chunks;
  int64_t const begin = int64_t(block % chunks) * each;
  int const end = int(min(begin + each, p.grad.width));
  Change const change = p.changed ? Change(int(read(p.changed[plane]))) : Change::but_nan;
  T const* const grad = p.grad.plane(plane);
  T* const grad_x = p.grad_x.plane(plane);
  if (change == Change::all) {
    AlignedBody<P, int> const body(grad_x, int(begin), end);
    F const none[P]{};
    body.for_each_peeled([&](int i) { grad_x[i] = round_to<T>(F(0)); });
    for (int i = body.begin + int(threadIdx.x) * P; i < body.end; i += kThreads * P)
      store_vector(grad_x + i * p.grad_x.step, none);
    return;
  }
  bool const stays = change == Change::none;
  auto const store_gradients = [&](auto const& vector, int i) {
    constexpr int N = sizeof(vector) / sizeof(T);
    F v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F const x = read(vector.v[k]);
      v[k] = stays ? x : F(0);
      if (!stays && x != x) v[k] = read(grad[(i + k) * p.grad.step]);
    }
    store_vector(grad_x + i * p.grad_x.step, v);
  };
  for_each_vector<kThreads, P>(stays ? grad : p.x.plane(plane), stays ? p.grad.step : p.x.step, int(begin), end,
                               store_gradients);
}

// Pixels of a chunk of gradients.
template <class T>
constexpr int kGradients = kThreads * kPixels<T> * 8;
template <class T>
KV_HD unsigned gradient_chunks(int64_t pixels) {
  return unsigned(ceil_div(pixels, int64_t(kGradients<T>)));
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads) equalize_gradients(EqualizeBackward<T> p, unsigned chunks) {
  gradients_of_chunk<P>(p, blockIdx.x, chunks, kGradients<T>);
}
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    equalize_gradients_of_list(__grid_constant__ EqualizeBackwardList<T> const p) {
  unsigned block;
  EqualizeBackward<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  EqualizeBackward<T> const flat = flat_gradients(*one);
  gradients_of_chunk<P>(flat, block, gradient_chunks<T>(flat.x.width), kGradients<T>);
}

// Pixels of a chunk: few enough for several blocks on every multiprocessor, so many that the tables cost little.
int64_t pixels_of_chunk(int64_t all) { return clamp(all >> 10, int64_t(8) << 10, int64_t(64) << 10) / 4096 * 4096; }

template <int P, class T>
int equalize_in_chunks(Equalize<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count(), pixels = p.x.width, each = pixels_of_chunk(planes * pixels);
  unsigned const chunks = unsigned(ceil_div(pixels, each)), blocks = unsigned(planes) * chunks;
  if (int const error = cudaMemsetAsync(p.counts, 0, planes * kLevels * sizeof(int32_t), stream)) return error;
  count_levels<T, P><<<blocks, kThreads, 0, stream>>>(p, chunks, int(each));
  map_levels<T, P><<<blocks, kThreads, 0, stream>>>(p, chunks, int(each));
  return cudaGetLastError();
}

// How planes are divided, `planes` of them with so many pixels at most, among the blocks of clusters.
struct Division {
  int parts, each;
  bool by_clusters;  // otherwise by chunks

  Division(int64_t planes, int64_t pixels, bool has_clusters, int64_t max_pixels) : parts(1) {
    int const most_parts = has_clusters ? kMaxClusterSize : 1;
    while (parts < most_parts && ceil_div(pixels, parts) > max_pixels) parts *= 2;
    // Few planes use all multiprocessors if each is split further; fewer still if they are split into chunks.
    while (parts < most_parts && planes * parts < 2 * multiprocessors() && pixels / parts > 8 << 10) parts *= 2;
    each = pixels_of_part(pixels, unsigned(parts));
    bool const few = planes * parts < (most_parts == 1 ? 64 : multiprocessors()) && pixels > 16 << 10;
    // Special case, H200: 1.34 (equalize) to 1.58 (equalize_opencv) times as fast as two passes.
    by_clusters = !few && each <= max_pixels;
  }
};

template <class T>
bool are_gradients_aligned(EqualizeBackward<T> const& p) {
  return are_equally_aligned<kPixels<T>>(p.grad_x, p.grad) && are_equally_aligned<kPixels<T>>(p.grad_x, p.x);
}

int64_t max_pixels_of_memory() { return min(kMaxPixels, max_shared_bytes() - kCountBytes - 4096); }

template <int P, class T>
int equalize_planes(Equalize<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count();
  // Special case, H200: 1.3 to 1.4 times as fast as levels in shared memory, bytes.
  if constexpr (sizeof(T) == 1 && P > 1) {
    Division const division(planes, p.x.width, supports_clusters(equalize_bytes), kMaxBytes);
    if (division.by_clusters)
      return launch_clusters(equalize_bytes, unsigned(planes * division.parts), kThreads, 0, unsigned(division.parts),
                             stream, p, unsigned(division.parts), division.each);
  }
  Division const division(planes, p.x.width, supports_clusters(equalize_parts<T, P>), max_pixels_of_memory());
  if (!division.by_clusters) return equalize_in_chunks<P>(p, stream);
  int const bytes = kCountBytes + division.each + 2 * P;
  if (int const error = cudaFuncSetAttribute(equalize_parts<T, P>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  return launch_clusters(equalize_parts<T, P>, unsigned(planes * division.parts), kThreads, bytes,
                         unsigned(division.parts), stream, p, unsigned(division.parts), division.each);
}

// By the division of as many planes of the largest size.
template <int P, class T>
int equalize_samples(EqualizeList<T> const& p, CUstream_st* stream) {
  int64_t most = 1, planes = int64_t(p.list.count) * p.channels;
  for (int b = 0; b < p.list.count; ++b) most = max(most, int64_t(p.list.results[b].height) * p.list.results[b].width);
  auto const pixels_of = [](Equalize<T> const& one) { return one.x.height * one.x.width; };
  auto const launch_parts = [&](auto* kernel, Division const& division, int bytes) {
    if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
      return error;
    int error = 0;
    int const failed = launch_list(
        p, [&](Equalize<T> const&) { return p.channels * division.parts; },
        [&](EqualizeList<T> const& list, unsigned blocks) {
          error = launch_clusters(kernel, blocks, kThreads, bytes, unsigned(division.parts), stream, list,
                                  unsigned(division.parts));
        });
    return error ? error : failed;
  };
  if constexpr (sizeof(T) == 1 && P > 1) {
    Division const division(planes, most, supports_clusters(equalize_bytes_of_list), kMaxBytes);
    if (division.by_clusters) return launch_parts(equalize_bytes_of_list, division, 0);
  }
  Division const division(planes, most, supports_clusters(equalize_parts_of_list<T, P>), max_pixels_of_memory());
  if (division.by_clusters)
    return launch_parts(equalize_parts_of_list<T, P>, division, kCountBytes + division.each + 2 * P);
  int const each = int(pixels_of_chunk(sum_of_samples(p, pixels_of) * p.channels));
  if (int const error = cudaMemsetAsync(p.all.counts, 0, planes * kLevels * sizeof(int32_t), stream)) return error;
  auto const launch = [&](auto maps) {
    return launch_list(
        p, [&](Equalize<T> const& one) { return p.channels * ceil_div(pixels_of(one), int64_t(each)); },
        [&](EqualizeList<T> const& list, unsigned blocks) {
          equalize_chunks_of_list<T, P, maps.value><<<blocks, kThreads, 0, stream>>>(list, each);
        });
  };
  int const error = launch(std::false_type{});
  return error ? error : launch(std::true_type{});
}

}  // namespace

template <class T>
int equalize(Equalize<T> const& p, CUstream_st* stream) {
  int error = 0;
  with_row_vectors<kRowVector<T>>(are_equally_aligned<kRowVector<T>>(p.x, p.y),
                                  [&](auto pixels) { error = equalize_planes<pixels.value>(p, stream); });
  return error;
}

template <class T>
int equalize_list(EqualizeList<T> const& p, CUstream_st* stream) {
  int error = 0;
  bool const aligned = all_samples(p, [](Equalize<T> const& one) {
    Equalize<T> const flat = flat_sample(one);
    return are_equally_aligned<kRowVector<T>>(flat.x, flat.y);
  });
  with_row_vectors<kRowVector<T>>(aligned, [&](auto pixels) { error = equalize_samples<pixels.value>(p, stream); });
  return error;
}

template <class T>
int equalize_backward(EqualizeBackward<T> const& p, CUstream_st* stream) {
  unsigned const chunks = gradient_chunks<T>(p.grad.width), blocks = unsigned(p.grad.count()) * chunks;
  with_row_vectors<kRowVector<T>>(are_gradients_aligned(p), [&](auto pixels) {
    equalize_gradients<T, pixels.value><<<blocks, kThreads, 0, stream>>>(p, chunks);
  });
  return cudaGetLastError();
}

template <class T>
int equalize_list_backward(EqualizeBackwardList<T> const& p, CUstream_st* stream) {
  bool const aligned =
      all_gradients(p, [](EqualizeBackward<T> const& one) { return are_gradients_aligned(flat_gradients(one)); });
  return launch_gradients(
      p,
      [&](EqualizeBackward<T> const& one) {
        return p.channels * int64_t(gradient_chunks<T>(one.x.height * one.x.width));
      },
      [&](EqualizeBackwardList<T> const& list, unsigned blocks) {
        with_row_vectors<kRowVector<T>>(aligned, [&](auto pixels) {
          equalize_gradients_of_list<T, pixels.value><<<blocks, kThreads, 0, stream>>>(list);
        });
      });
}

KV_INSTANTIATE_WITH_BYTES(equalize, Equalize)
KV_INSTANTIATE_WITH_BYTES(equalize_list, EqualizeList)
KV_INSTANTIATE(equalize_backward, EqualizeBackward)
KV_INSTANTIATE(equalize_list_backward, EqualizeBackwardList)

}  // namespace kv::enhance::cuda
