// Histogram equalization on CUDA. A plane whose levels fit the shared memory of one multiprocessor is read once: one
// block counts its levels, keeps them as bytes and maps them with the table. Larger planes are counted by several
// blocks and read again.
#include "byte_histogram.cuh"
#include "equalize.h"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 384;
using Counter = LevelCounter<8>;
constexpr int kCountBytes = Counter::kSize * int(sizeof(int32_t));
template <class T>
constexpr int kBlocks = sizeof(T) == 8 ? 2 : 3;  // per multiprocessor

// A few large planes use more multiprocessors if they are split into chunks.
constexpr bool fits_one_block(int64_t planes, int64_t pixels) {
  return pixels <= (planes >= 64 ? 192 << 10 : 16 << 10);
}

// The table from level to value, in as many copies as fit the memory of the counts.
template <class F>
struct Table {
  static constexpr int kTables = kCountBytes / (kLevels * int(sizeof(F)));
  F const* values;
  __device__ __forceinline__ F operator[](int level) const { return values[level * kTables + threadIdx.x % kTables]; }
};

// Builds the table in `memory` from the counts; thread i < kLevels has the count of level i. False if the plane stays
// unchanged.
template <class F>
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
  if (level < kLevels && curve.changes()) {
    F const value = F(curve(up_to, count)) / 255;
    F* const values = static_cast<F*>(memory) + level * Table<F>::kTables;
#pragma unroll
    for (int i = 0; i < Table<F>::kTables; ++i) values[i] = value;
  }
  __syncthreads();
  return curve.changes();
}

// Maps the pixels [begin, end) of a plane; without a table, copies them.
template <bool Vectorized, class T>
__device__ __forceinline__ void map_pixels(Equalize<T> const& p, int64_t plane, int begin, int end, bool has_table,
                                           Table<Compute<T>> table) {
  constexpr int P = kPixels<T>;
  T* const y = p.y.plane(plane);
  for_each_vector<kThreads, Vectorized, P>(p.x.plane(plane), p.x.step, begin, end,
                                           [&](Vector<T, P> const& vector, int i) {
                                             Compute<T> v[P];
#pragma unroll
                                             for (int k = 0; k < P; ++k) {
                                               int const level = level_of(vector.v[k]);
                                               v[k] = has_table && level < kLevels ? table[level] : read(vector.v[k]);
                                             }
                                             store_pixels<Vectorized>(y, p.y.step, i, end, v);
                                           });
}

template <class T>
__global__ void __launch_bounds__(kThreads, kBlocks<T>) equalize_plane(Equalize<T> p) {
  using F = Compute<T>;
  constexpr int P = kPixels<T>;
  extern __shared__ __align__(16) unsigned char memory[];
  Counter const counter{reinterpret_cast<int32_t*>(memory)};
  unsigned char* const levels = memory + kCountBytes;  // one per pixel, in vectors
  int const n = int(p.x.width);

  counter.clear();
  __syncthreads();
  bool has_nan = false;
  for_each_vector<kThreads, true, P>(p.x.plane(blockIdx.x), 1, 0, n, [&](Vector<T, P> const& vector, int i) {
    Vector<unsigned char, P> bytes;
#pragma unroll
    for (int k = 0; k < P; ++k) {
      int const level = level_of(vector.v[k]);
      counter.add(level);
      has_nan = has_nan || level == kNanLevel;
      bytes.v[k] = static_cast<unsigned char>(level);
    }
    *reinterpret_cast<Vector<unsigned char, P>*>(levels + i) = bytes;
  });
  has_nan = __syncthreads_or(has_nan);
  int const count = threadIdx.x < kLevels ? counter[threadIdx.x] : 0;
  __syncthreads();
  int counted;
  bool const changes = make_table<F>(count, p.opencv, memory, counted);
  Table<F> const table{reinterpret_cast<F*>(memory)};
  if (threadIdx.x == 0)
    p.changed[blockIdx.x] = round_to<T>(F(int(!changes ? Change::none : has_nan ? Change::but_nan : Change::all)));

  // A byte cannot represent NaN.
  if (has_nan || !changes) return map_pixels<true>(p, blockIdx.x, 0, n, changes, table);
  T* const y = p.y.plane(blockIdx.x);
  for (int i = int(threadIdx.x) * P; i < n; i += kThreads * P) {
    Vector<unsigned char, P> const bytes = *reinterpret_cast<Vector<unsigned char, P> const*>(levels + i);
    F v[P];
#pragma unroll
    for (int k = 0; k < P; ++k) v[k] = table[bytes.v[k]];
    store_vector(y + i, v);
  }
}

// Chunks of planes, `each` pixels per block.
template <class T, bool Vectorized>
__global__ void __launch_bounds__(kThreads, kBlocks<T>) count_levels(Equalize<T> p, unsigned chunks, int each) {
  constexpr int P = kPixels<T>;
  __shared__ int32_t counts[Counter::kSize];
  Counter const counter{counts};
  unsigned const plane = blockIdx.x / chunks;
  int64_t const begin = int64_t(blockIdx.x % chunks) * each;
  int const end = int(min(begin + each, p.x.width));
  counter.clear();
  __syncthreads();
  for_each_vector<kThreads, Vectorized, P>(p.x.plane(plane), p.x.step, int(begin), end,
                                           [&](Vector<T, P> const& vector, int i) {
#pragma unroll
                                             for (int k = 0; k < P; ++k)
                                               if (Vectorized || i + k < end) counter.add(level_of(vector.v[k]));
                                           });
  __syncthreads();
  if (threadIdx.x < kLevels) atomicAdd(p.counts + int64_t(plane) * kLevels + threadIdx.x, counter[threadIdx.x]);
}

template <class T, bool Vectorized>
__global__ void __launch_bounds__(kThreads, kBlocks<T>) map_levels(Equalize<T> p, unsigned chunks, int each) {
  using F = Compute<T>;
  __shared__ __align__(16) unsigned char memory[kCountBytes];
  unsigned const plane = blockIdx.x / chunks;
  int64_t const begin = int64_t(blockIdx.x % chunks) * each;
  int const count = threadIdx.x < kLevels ? p.counts[int64_t(plane) * kLevels + threadIdx.x] : 0;
  int counted;
  bool const changes = make_table<F>(count, p.opencv, memory, counted);
  if (begin == 0 && threadIdx.x == 0) {
    bool const has_nan = counted < p.x.width;
    p.changed[plane] = round_to<T>(F(int(!changes ? Change::none : has_nan ? Change::but_nan : Change::all)));
  }
  map_pixels<Vectorized>(p, plane, int(begin), int(min(begin + each, p.x.width)), changes,
                         Table<F>{reinterpret_cast<F*>(memory)});
}

// The gradient is read only where it passes: nowhere, for most planes.
template <class T, bool Vectorized>
__global__ void __launch_bounds__(kThreads) equalize_gradients(EqualizeBackward<T> p, unsigned chunks, int each) {
  using F = Compute<T>;
  constexpr int P = kPixels<T>;
  unsigned const plane = blockIdx.x / chunks;
  int64_t const begin = int64_t(blockIdx.x % chunks) * each;
  int const end = int(min(begin + each, p.grad.width));
  Change const change = p.changed ? Change(int(read(p.changed[plane]))) : Change::but_nan;
  T const* const grad = p.grad.plane(plane);
  T* const grad_x = p.grad_x.plane(plane);
  if (change == Change::all) {
    F const none[P]{};
    for (int i = int(begin) + int(threadIdx.x) * P; i < end; i += kThreads * P)
      store_pixels<Vectorized>(grad_x, p.grad_x.step, i, end, none);
    return;
  }
  bool const stays = change == Change::none;
  Planes<T const> const& first = stays ? p.grad : p.output;
  auto const pull = [&](Vector<T, P> const& vector, int i) {
    F v[P];
#pragma unroll
    for (int k = 0; k < P; ++k) {
      F const x = read(vector.v[k]);
      v[k] = stays ? x : F(0);
      if (!stays && x != x) v[k] = read(grad[(i + k) * p.grad.step]);
    }
    store_pixels<Vectorized>(grad_x, p.grad_x.step, i, end, v);
  };
  for_each_vector<kThreads, Vectorized, P>(first.plane(plane), first.step, int(begin), end, pull);
}

template <bool Vectorized, class T>
int equalize_in_chunks(Equalize<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count(), pixels = p.x.width;
  // Small enough for several blocks on every multiprocessor, large enough that the tables cost little.
  int64_t const each = clamp((planes * pixels) >> 10, int64_t(8) << 10, int64_t(64) << 10) / 4096 * 4096;
  unsigned const chunks = unsigned(ceil_div(pixels, each)), blocks = unsigned(planes) * chunks;
  if (int const error = cudaMemsetAsync(p.counts, 0, planes * kLevels * sizeof(int32_t), stream)) return error;
  count_levels<T, Vectorized><<<blocks, kThreads, 0, stream>>>(p, chunks, int(each));
  map_levels<T, Vectorized><<<blocks, kThreads, 0, stream>>>(p, chunks, int(each));
  return cudaGetLastError();
}

}  // namespace

template <class T>
int equalize(Equalize<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  if (!is_vectorizable<P>(p.x) || !is_vectorizable<P>(p.y)) return equalize_in_chunks<false>(p, stream);
  int64_t const planes = p.x.count(), pixels = p.x.width;
  if (!fits_one_block(planes, pixels)) return equalize_in_chunks<true>(p, stream);
  int const bytes = kCountBytes + int(pixels);
  if (int const error = cudaFuncSetAttribute(equalize_plane<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  equalize_plane<<<unsigned(planes), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int equalize_backward(EqualizeBackward<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  int64_t const planes = p.grad.count(), each = kThreads * P * 8;
  unsigned const chunks = unsigned(ceil_div(p.grad.width, each)), blocks = unsigned(planes) * chunks;
  if (is_vectorizable<P>(p.grad) && is_vectorizable<P>(p.output) && is_vectorizable<P>(p.grad_x))
    equalize_gradients<T, true><<<blocks, kThreads, 0, stream>>>(p, chunks, int(each));
  else
    equalize_gradients<T, false><<<blocks, kThreads, 0, stream>>>(p, chunks, int(each));
  return cudaGetLastError();
}

KV_INSTANTIATE(equalize, Equalize)
KV_INSTANTIATE(equalize_backward, EqualizeBackward)

}  // namespace kv::enhance::cuda
