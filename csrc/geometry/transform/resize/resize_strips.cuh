// Resizing of any kind by any factor on CUDA, and its backward pass: what a block does, for batches and lists.
//
// A warp traverses a strip of the image downwards, whose rows come to shared memory by asynchronous copies, some rows
// ahead. Where the image shrinks, a row is added to the sums of the few windows that hold it, which are in registers;
// where it grows, a row of the result is the weighted sum of a few rows in shared memory. That line of sums then goes
// to shared memory, and the pixels of the result are weighted means of it.
//
//   strip of the image     rows, copied by 16 bytes where all of them are whole vectors, else by words of 4
//   line                   one sum a column; some lines are weighted along x together
//   strip of the result    each thread every 32nd element
//
// A block computes the weights once for its warps, which take the same columns of several planes.
#pragma once

#include <cuda_pipeline.h>

#include "core/block_reduce.cuh"
#include "core/launch.cuh"
#include "core/row_prefetcher.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kMaxElements = 256;  // of the result in a row of a strip

// M: the most windows that hold a row, where the image shrinks, or the most rows in a window, where it grows. W: the
// warps of a block, of which 24 are on a multiprocessor at once.
template <class T, int M, bool Shrinks, int W = 8>
struct StripOf {
  static constexpr int kWarps = W, kThreads = 32 * W, kBlocks = 24 / W;
  static constexpr int kSpan = Shrinks && M <= 4 ? 256 : 128;  // elements of a row
  static constexpr int kColumns = kSpan / 32;                  // of a thread, some of them adjacent
  static constexpr int kVector = 16 / int(sizeof(T)), kRowBytes = kSpan * int(sizeof(T));
  static constexpr int kRing = Shrinks && sizeof(T) == 4 ? 4 : 8, kAhead = Shrinks ? kRing - 2 : kRing - M;
  static constexpr int kLines = M > 4 ? M : 4;          // rows of sums at a time
  static constexpr int kSlots = M > 4 ? 8 : M;          // weights of a row
  static constexpr int kWarpBytes = kRing * kRowBytes;  // of rows
};

// How the result is divided among blocks and warps.
struct ResizeStrips {
  unsigned across, down;  // strips of columns, and blocks one below the other
  int elements, rows;     // of a strip
  int warps_down;         // strips of a block one below the other; its other warps take other planes
  int lines;              // numbers in a warp's lines
  int span_y;             // rows of x that a strip reads, at most
};

// Not inlined: these take most of the time to compile. They serve what the functions below do not.
__device__ __noinline__ Contributors<float> call_contributors(ResizeAxis const& axis, int index) {
  return unnormalized_contributors<float>(axis, index);
}
__device__ __noinline__ Band<float> call_extent(ResizeAxis const& axis, int i) { return extent<float>(axis, i); }
__device__ __noinline__ float call_weight(ResizeAxis const& axis, float norm, int i, int j) {
  return band_weight(axis, Band<float>{0, 0, norm}, i, j);
}

__device__ __forceinline__ Contributors<float> find_contributors(ResizeAxis const& axis, int index) {
  if (!axis.has_window() || axis.num == 0) return call_contributors(axis, index);
  if (axis.backward) return window_holders<float>(axis, index);
  Band<float> const band = window_band<float>(axis, index);
  return {band.first, band.last - band.first + 1, 1};
}
// The weight of source pixel j in pixel i of the result.
__device__ __forceinline__ float find_weight(ResizeAxis const& axis, float norm, int i, int j) {
  bool const is_border = axis.clamps_taps() && (j == 0 || j == axis.source - 1);
  if ((axis.filter != ResizeFilter::bilinear && axis.filter != ResizeFilter::bicubic) || is_border)
    return call_weight(axis, norm, i, j);
  return window_at<float>(axis, j * axis.den - axis.center(i)) * norm;
}

// The sum over `group` adjacent threads, for all of them.
__device__ __forceinline__ float group_sum(float x, int group) {
  for (int lane = group / 2; lane > 0; lane /= 2) x += __shfl_xor_sync(0xffffffffu, x, lane);
  return x;
}

// Writes the factors of the weights of `count` pixels of the result from `from` on, for the backward pass. `thread`: of
// a block of `threads`, in any order of its warps.
__device__ __forceinline__ void write_norms(ResizeAxis const& axis, int thread, int threads, float* norms, int from,
                                            int count) {
  int const group = axis.max_readers > 8 ? 8 : 2, all = (count + 31) / 32 * 32 * group;  // `group` threads a pixel
#pragma unroll 1
  for (int t = thread; t < all; t += threads) {
    int const i = t / group, index = min(from + i, axis.result - 1);
    Band<float> const band = axis.has_window() ? window_band<float>(axis, index) : call_extent(axis, index);
    float sum = 0;
    if (axis.is_normalized())
#pragma unroll 1
      for (int j = band.first + t % group; j <= band.last; j += group) sum += find_weight(axis, 1, index, j);
    sum = group_sum(sum, group);
    if (i < count && t % group == 0) norms[i] = axis.is_normalized() ? 1 / sum : band.norm;
  }
}

// The weights of a part of an axis of the output, in shared memory.
struct WeightTable {
  int first_pixel, last_pixel, step, slots;  // of `slots` entries, a multiple of 32, `step` are for each pixel
  float* weights;
  int pixel_stride, tap_stride;
  int *first, *end;    // the first pixel that is read, and the one after the last one
  float const* norms;  // of the backward pass, those of pixels of the result from `norms_from` on
  int norms_from;

  // `thread`: as above.
  __device__ __forceinline__ void write(ResizeAxis const& axis, int thread, int threads) const {
    int const group = axis.max_taps > 8 ? 8 : 1;  // threads that share an entry
#pragma unroll 1
    for (int t = thread; t < slots * group; t += threads) {
      int const i = t / group, index = min(first_pixel + (step == 1 ? i : i / step), last_pixel);
      Contributors<float> const reads = find_contributors(axis, index);
      float* const to = weights + i * pixel_stride;
      float sum = 0;
#pragma unroll 1
      for (int k = t % group; k < axis.max_taps; k += group) {
        int const at = reads.first + k;
        float weight = 0;
        if (k < reads.count)
          weight = axis.backward ? find_weight(axis, norms[at - norms_from], at, index)
                                 : find_weight(axis, reads.norm, index, at);
        to[k * tap_stride] = weight;
        sum += weight;
      }
      if (!axis.backward && axis.is_normalized()) {
        float const norm = 1 / group_sum(sum, group);
        for (int k = t % group; k < axis.max_taps; k += group) to[k * tap_stride] *= norm;
      }
      if (t % group == 0) first[i] = reads.first, end[i] = reads.first + reads.count;
    }
  }
};

// The pixels of a thread in a row: groups of four adjacent ones, 128 apart. The row begins `past` bytes after a word.
template <class S, class T>
__device__ __forceinline__ void read_pixels(T const* row, int past, float (&pixels)[S::kColumns]) {
#pragma unroll
  for (int i = 0; i < S::kColumns; i += 4) {
    T const* const four = row + 32 * i + 4 * int(threadIdx.x % 32);
    if constexpr (sizeof(T) == 4) {
      Vector<T, 4> const vector = *reinterpret_cast<Vector<T, 4> const*>(four);
#pragma unroll
      for (int j = 0; j < 4; ++j) pixels[i + j] = vector.v[j];
    } else {
      constexpr int kWords = int(sizeof(T));  // and some bytes of the next one, if the row has one
      Vector<uint32_t, kWords> words = *reinterpret_cast<Vector<uint32_t, kWords> const*>(four);
      bool const has_next = i + 4 < S::kColumns || threadIdx.x % 32 < 31;
      uint32_t const next = has_next ? reinterpret_cast<uint32_t const*>(four)[kWords] : 0;
#pragma unroll
      for (int j = 0; j < kWords; ++j)
        words.v[j] = __funnelshift_r(words.v[j], j + 1 < kWords ? words.v[min(j + 1, kWords - 1)] : next, 8 * past);
#pragma unroll
      for (int j = 0; j < 4; ++j) {
        uint32_t const bits = words.v[j * kWords / 4] >> 8 * kWords * j % 32;
        if constexpr (sizeof(T) == 1)
          pixels[i + j] = float(bits & 255);
        else
          pixels[i + j] = read(T{uint16_t(bits)});
      }
    }
  }
}

// Where a block keeps its rings, lines and tables in shared memory.
template <class S, bool Shrinks>
struct StripMemory {
  unsigned char* ring;             // of the warp
  float *lines, *weights_of_rows;  // of the warp; of a row of x in the rows of the result that it is part of,
  float *weights_x, *weights_y;    // by their numbers modulo M
  int *first_x, *end_x, *first_y, *end_y;
  float *norms_x, *norms_y;

  template <class T>
  __device__ __forceinline__ StripMemory(Resize<T> const& p, ResizeStrips const& strips, unsigned char* memory,
                                         int row_slots) {
    int const warp = threadIdx.x / 32, columns_padded = (strips.elements + 31) & -32;
    float* const all_lines = reinterpret_cast<float*>(memory + S::kWarps * S::kWarpBytes);
    ring = memory + warp * S::kWarpBytes;
    lines = all_lines + warp * strips.lines;
    weights_of_rows = all_lines + S::kWarps * strips.lines;
    weights_x = weights_of_rows + (Shrinks ? strips.warps_down * strips.span_y * S::kSlots : 0);
    first_x = reinterpret_cast<int*>(weights_x + p.columns.max_taps * columns_padded);
    end_x = first_x + columns_padded;
    weights_y = reinterpret_cast<float*>(end_x + columns_padded);
    first_y = reinterpret_cast<int*>(weights_y + p.rows.max_taps * row_slots);
    end_y = first_y + row_slots;
    norms_x = reinterpret_cast<float*>(end_y + row_slots);
    norms_y = norms_x + (p.columns.backward ? S::kSpan : 0);
  }
};

// The ring of rows of a warp, in which a row begins at a word as it does in the image.
template <class S, class T>
struct RowRing {
  unsigned char* const memory;
  T const* const column;  // the first element of row 0
  int const stride, length, end;
  bool const aligned;
  int next, unsafe_from = 0;  // the row that is copied next; the first one whose last word may reach behind the image

  // Bytes from a word to the beginning of a row.
  __device__ __forceinline__ int past_word(int y) const {
    return sizeof(T) == 4 ? 0 : int(reinterpret_cast<uintptr_t>(column) + unsigned(y) * unsigned(stride)) & 3;
  }
  __device__ __forceinline__ void fetch() {
    int const lane = threadIdx.x % 32;
    if (next < end) {
      auto const to = uint32_t(__cvta_generic_to_shared(memory)) + (next & (S::kRing - 1)) * S::kRowBytes;
      auto const row = reinterpret_cast<unsigned char const*>(row_at(column, next, stride));
      int const bytes = length * int(sizeof(T));
      if (aligned) {
#pragma unroll
        for (int at = 0; at < S::kRowBytes; at += 512)
          copy_async_if<16>(to + 16 * lane + at, row + 16 * lane + at, 16 * lane + at < bytes, false);
      } else {
        int const past = past_word(next), end = bytes + past;
#pragma unroll
        for (int i = 0; i < S::kRowBytes; i += 128) {
          int const at = 4 * lane + i;
          bool const unsafe = sizeof(T) < 4 && next >= unsafe_from && at < end && at + 4 > end;
          copy_async_if<4>(to + at, row - past + at, at < end && !unsafe, false);
          if (unsafe)
            copy_start<4 / int(sizeof(T))>(to + at, reinterpret_cast<T const*>(row - past + at),
                                           (end - at) / int(sizeof(T)));
        }
      }
    }
    __pipeline_commit();
    ++next;
  }
  __device__ __forceinline__ void read(int y, float (&pixels)[S::kColumns]) const {
    read_pixels<S>(reinterpret_cast<T const*>(memory + (y & (S::kRing - 1)) * S::kRowBytes), aligned ? 0 : past_word(y),
                   pixels);
  }
};

template <int N>
__device__ __forceinline__ void add_weighted(float (&sums)[N], float weight, float const (&pixels)[N]) {
  if (weight != 0) {
#pragma unroll
    for (int i = 0; i < N; ++i) sums[i] += weight * pixels[i];
  }
}

// Line j of the sums along y.
template <class S>
__device__ __forceinline__ void store_line(float* lines, int j, float const (&sums)[S::kColumns]) {
  constexpr int P = 4;
#pragma unroll
  for (int i = 0; i < S::kColumns; i += P) {
    Vector<float, P> vector;
#pragma unroll
    for (int n = 0; n < P; ++n) vector.v[n] = sums[i + n];
    *reinterpret_cast<Vector<float, P>*>(lines + j * S::kSpan + 32 * i + P * int(threadIdx.x % 32)) = vector;
  }
}

// The pixels of `count` rows of the result from the lines of sums along y. Taps: the number of weights, or 0 for any.
template <class S, int Taps, class T, class Memory>
__device__ __forceinline__ void write_rows(Resize<T> const& p, Memory const& memory, int elements, int count, T* out) {
  int const taps_x = p.columns.max_taps, K = Taps ? Taps : taps_x, step = int(p.x.step);
  int const padded = (elements + 31) & -32;
#pragma unroll 1
  for (int c = int(threadIdx.x % 32); c < padded; c += 32) {
    float sums[S::kLines] = {};
    float const *values = memory.lines + memory.first_x[c], *weight = memory.weights_x + c;
#pragma unroll
    for (int k = 0; k < K; ++k, values += step, weight += padded)
#pragma unroll
      for (int j = 0; j < S::kLines; ++j) sums[j] += *weight * values[j * S::kSpan];
    float poison = 0;
#pragma unroll
    for (int j = 0; j < S::kLines; ++j) poison += sums[j] * 0;
    if (poison != 0) {  // a tap of weight 0 contributes nothing, even if it is inf or NaN
#pragma unroll
      for (int j = 0; j < S::kLines; ++j) sums[j] = 0;
#pragma unroll 1
      for (int k = 0; k < taps_x; ++k)
        if (float const of_tap = memory.weights_x[k * padded + c]; of_tap != 0)
#pragma unroll
          for (int j = 0; j < S::kLines; ++j)
            sums[j] += of_tap * memory.lines[memory.first_x[c] + k * step + j * S::kSpan];
    }
    if (c >= elements) break;
    T* to = out + c;
#pragma unroll
    for (int j = 0; j < S::kLines; ++j, to += p.y.row_stride)
      if (j < count) *to = round_to<T>(p.minuend ? float(read(*p.minuend_at(to))) - sums[j] : sums[j]);
  }
}
template <class S, class T, class Memory>
__device__ __forceinline__ void write_rows(Resize<T> const& p, Memory const& memory, int elements, int count, T* out) {
  __syncwarp();
  int const taps = p.columns.max_taps;
  if (taps == 2)
    write_rows<S, 2>(p, memory, elements, count, out);
  else if (taps == 3)
    write_rows<S, 3>(p, memory, elements, count, out);
  else if (taps == 4)
    write_rows<S, 4>(p, memory, elements, count, out);
  else if (taps == 5)
    write_rows<S, 5>(p, memory, elements, count, out);
  else
    write_rows<S, 0>(p, memory, elements, count, out);
  __syncwarp();
}

// The strips of block number `block`.
template <class T, int M, bool Shrinks, int W = 8>
__device__ __forceinline__ void resize_block(Resize<T> const& p, ResizeStrips const& strips, bool aligned,
                                             unsigned block) {
  using S = StripOf<T, M, Shrinks, W>;
  constexpr int kThreads = S::kThreads;
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32, step = int(p.x.step);
  unsigned const q = block / strips.across, group = q / strips.down;
  int const e0 = int(block - q * strips.across) * strips.elements;
  int const elements = min(strips.elements, int(p.y.row_size()) - e0), padded = (elements + 31) & -32;
  int const taps_y = p.rows.max_taps, height = int(p.y.height);
  int const block_y = int(q - group * strips.down) * strips.rows * strips.warps_down;
  int const table_rows = strips.rows * strips.warps_down, row_slots = (table_rows + 31) & -32;
  int const planes_per_block = W / strips.warps_down;
  int64_t const plane = int64_t(group) * planes_per_block + warp / strips.warps_down;
  int const first_row = warp % strips.warps_down * strips.rows, y0 = block_y + first_row;  // of the warp
  int const rows = plane < p.y.count() ? min(strips.rows, height - y0) : 0;
  extern __shared__ __align__(16) unsigned char shared[];
  StripMemory<S, Shrinks> const memory(p, strips, shared, row_slots);

  // Phase 1: the pixels that the strip, the warp and the block read: each thread finds one end.
  int const last_x = (e0 + elements - 1) / step, last_y = min(y0 + strips.rows, height) - 1;
  int const ends[4] = {min(y0, height - 1), max(last_y, 0), block_y, min(block_y + table_rows, height) - 1};
  Contributors<float> const of_column = find_contributors(p.columns, lane % 2 ? last_x : e0 / step);
  Contributors<float> const of_row =
      find_contributors(p.rows, lane % 4 < 2 ? (lane % 2 ? ends[1] : ends[0]) : (lane % 2 ? ends[3] : ends[2]));
  auto const begin_of = [&](Contributors<float> const& of, int i) { return __shfl_sync(0xffffffffu, of.first, i); };
  auto const end_of = [&](Contributors<float> const& of, int i) {
    return __shfl_sync(0xffffffffu, of.first + of.count, i);
  };
  int const from_x = begin_of(of_column, 0), to_x = end_of(of_column, 1),
            from = from_x * step & (aligned ? -S::kVector : -1);
  int const length = min(to_x * step - from, S::kSpan);
  int const from_y = begin_of(of_row, 0), to_y = end_of(of_row, 1);
  int const block_from_y = begin_of(of_row, 2), block_to_y = end_of(of_row, 3);

  // Phase 2: the first rows are on their way while the weights are computed.
  RowRing<S, T> ring{
      memory.ring, p.x.plane(rows > 0 ? plane : 0) + from, int(p.x.row_stride * sizeof(T)), length, to_y, aligned,
      from_y};
  if (sizeof(T) < 4 && rows > 0)
    ring.unsafe_from = first_unsafe_row<4 / int(sizeof(T))>(p.x, p.x.plane(plane), p.x.row_size());
  for (int i = 16 * lane; i < S::kWarpBytes; i += 512) *reinterpret_cast<uint4*>(memory.ring + i) = uint4{};
  for (int i = S::kLines * S::kSpan + lane; i < strips.lines; i += 32) memory.lines[i] = 0;  // read with weight 0
  __syncwarp();
  if (rows > 0)
#pragma unroll 1
    for (int i = 0; i < (Shrinks ? S::kRing - 1 : S::kRing); ++i) ring.fetch();

  // Phase 3: the weights. The last warps begin with those of rows.
  int const thread_of_rows = 32 * (W - 1 - warp) + lane;
  if (p.columns.backward) {
    write_norms(p.columns, threadIdx.x, kThreads, memory.norms_x, from_x, min(to_x - from_x, S::kSpan));
    write_norms(p.rows, thread_of_rows, kThreads, memory.norms_y, block_from_y, block_to_y - block_from_y);
    __syncthreads();
  }
  int const last_row = min(block_y + table_rows, height) - 1;
  WeightTable const columns{e0 / step,      last_x,       step,           padded, memory.weights_x, 1, padded,
                            memory.first_x, memory.end_x, memory.norms_x, from_x};
  columns.write(p.columns, threadIdx.x, kThreads);
  WeightTable const of_rows{block_y,          last_row,       1,           row_slots,
                            memory.weights_y, taps_y,         1,           memory.first_y,
                            memory.end_y,     memory.norms_y, block_from_y};
  of_rows.write(p.rows, thread_of_rows, kThreads);
  if constexpr (Shrinks)
    for (int i = threadIdx.x; i < strips.warps_down * strips.span_y * S::kSlots; i += kThreads)
      memory.weights_of_rows[i] = 0;
  __syncthreads();
  for (int i = threadIdx.x; i < padded; i += kThreads) {
    int const e = e0 + min(i, elements - 1);
    memory.first_x[i] = min(memory.first_x[i] * step + e % step - from, S::kSpan);
  }
  if constexpr (Shrinks) {
    int const count = min(table_rows, height - block_y);
    for (int i = threadIdx.x; i < count * taps_y; i += kThreads) {
      int const r = i / taps_y, k = i - r * taps_y, strip = r / strips.rows, y = memory.first_y[r] + k;
      int const at = y - memory.first_y[strip * strips.rows];
      if (y < memory.end_y[r] && at < strips.span_y)
        memory.weights_of_rows[(strip * strips.span_y + at) * S::kSlots + (r - strip * strips.rows) % M] =
            memory.weights_y[i];
    }
  }
  __syncthreads();
  if (rows <= 0) return;

  // Phase 4: sums along y, and the rows of the result from them.
  T* out = p.y.row(plane, y0) + e0;
  auto const write = [&](int count) {
    write_rows<S>(p, memory, elements, count, out);
    out += count * p.y.row_stride;
  };
  if constexpr (Shrinks) {
    float sums[M][S::kColumns] = {};
    auto const* weights = reinterpret_cast<Vector<float, S::kSlots> const*>(memory.weights_of_rows) +
                          warp % strips.warps_down * strips.span_y;
    int y = from_y;
#pragma unroll 1
    for (int r = 0; r < rows; r += S::kLines) {
#pragma unroll
      for (int j = 0; j < S::kLines; ++j) {
        int const end = r + j < rows ? memory.end_y[first_row + r + j] : 0;
#pragma unroll 1
        for (; y < end; ++y, ++weights) {
          __pipeline_wait_prior(S::kAhead);
          __syncwarp();
          ring.fetch();
          float pixels[S::kColumns];
          ring.read(y, pixels);
          Vector<float, S::kSlots> const of_row = *weights;
#pragma unroll
          for (int s = 0; s < M; ++s) add_weighted(sums[s], of_row.v[s], pixels);
        }
        store_line<S>(memory.lines, j, sums[j % M]);
#pragma unroll
        for (int i = 0; i < S::kColumns; ++i) sums[j % M][i] = 0;
      }
      write(min(S::kLines, rows - r));
    }
  } else {
#pragma unroll 1
    for (int r = 0; r < rows; r += S::kLines) {
#pragma unroll 1
      for (int j = 0; j < min(S::kLines, rows - r); ++j) {
        int const row = first_row + r + j, first = memory.first_y[row], end = memory.end_y[row];
        while (ring.next < end + S::kAhead) ring.fetch();
        __pipeline_wait_prior(S::kAhead);
        __syncwarp();
        float sums[S::kColumns] = {};
#pragma unroll
        for (int k = 0; k < M; ++k) {
          if (first + k >= end) break;
          float pixels[S::kColumns];
          ring.read(first + k, pixels);
          add_weighted(sums, memory.weights_y[row * taps_y + k], pixels);
        }
        store_line<S>(memory.lines, j, sums);
        __syncwarp();
      }
      write(min(S::kLines, rows - r));
    }
  }
}

// --- plans -----------------------------------------------------------------------------------------------------------

// The most adjacent pixels of a row of the output that read at most `span` adjacent ones.
KV_HD int64_t pixels_of_span(ResizeAxis const& a, int64_t span) {
  int64_t const step = a.backward ? a.den : a.num, unit = a.backward ? a.num : a.den;  // a pixel of y, and one of x
  int64_t const band = a.has_window() ? 2 * filter_radius(a.filter) * a.unit : (a.max_taps + 1) * unit;
  if (span * unit < band) return 0;
  return step ? (span * unit - band) / step + 1 : INT64_MAX;
}

// Whether rows are whole vectors.
template <class S, class T>
KV_HD bool strips_are_aligned(Planes<T const> const& x) {
  return reinterpret_cast<uintptr_t>(x.data) % 16 == 0 && x.row_stride % S::kVector == 0 &&
         x.inner_stride % S::kVector == 0 && x.outer_stride % S::kVector == 0 && x.row_size() % S::kVector == 0;
}

// Divides columns among strips. False if none are served.
template <class S, class T>
KV_HD bool divide_columns(Resize<T> const& p, bool aligned, ResizeStrips& strips) {
  // A strip that does not begin with a whole vector or word copies some elements before its first one.
  int64_t const step = p.x.step, before = aligned ? S::kVector - 1 : 4 / int(sizeof(T)) - 1;
  bool const whole = p.x.row_size() <= S::kSpan - (aligned ? 0 : before);
  int64_t const max_columns = min(whole ? p.y.width : pixels_of_span(p.columns, (S::kSpan - before) / step),
                                  max(kMaxElements / step, int64_t(1)));
  if (max_columns == 0 || step > kMaxElements) return false;
  strips.across = unsigned(ceil_div(p.y.width, max_columns));
  strips.elements = int(ceil_div(p.y.width, int64_t(strips.across)) * step);
  strips.lines = (S::kLines * S::kSpan + int(p.columns.max_taps * step) + 4) & -4;
  return true;
}

// The rows of x that `rows` rows of the output read, at most.
template <class T>
KV_HD int64_t rows_read(Resize<T> const& p, int64_t rows) {
  int64_t const to = p.rows.backward ? p.rows.den : p.rows.num, from = p.rows.backward ? p.rows.num : p.rows.den;
  return min(from ? ceil_div(rows * to, from) + p.rows.max_taps + 1 : p.x.height, p.x.height);
}
template <class T>
KV_HD void divide_rows(Resize<T> const& p, int rows, ResizeStrips& strips) {
  strips.rows = rows;
  strips.span_y = int(rows_read(p, rows));
  strips.down = unsigned(ceil_div(p.y.height, int64_t(rows) * strips.warps_down));
}

// Planes side by side in a block of 8 warps share its weights, unless too many warps had none: `idle` of them for each
// plane in all.
inline int warps_down_of(int64_t planes, double idle) {
  int down = 1;
  while (double(-planes & (8 / down - 1)) > idle * double(planes)) down *= 2;
  return down;
}

// The shared memory of a block whose strips have so many rows.
template <class S, bool Shrinks, class T>
int64_t strip_bytes(Resize<T> const& p, ResizeStrips const& strips, int64_t rows) {
  int64_t const slots = (rows * strips.warps_down + 31) & -32, padded = (strips.elements + 31) & -32;
  int64_t const norms = p.rows.backward ? S::kSpan + rows_read(p, rows * strips.warps_down) : 0;
  int64_t const of_rows = Shrinks ? strips.warps_down * rows_read(p, rows) * S::kSlots : 0;
  return S::kWarps * (S::kWarpBytes + 4 * int64_t(strips.lines)) +
         4 * ((p.columns.max_taps + 2) * padded + (p.rows.max_taps + 2) * slots + norms + of_rows);
}

// Rows of a strip for which there is room, 0 if there is none, where a block has bytes_of(rows) of shared memory. More
// than one row is for at most `wanted` bytes.
template <class BytesOf>
int64_t most_rows(BytesOf bytes_of, int64_t wanted = 100 << 10) {
  int64_t rows = 64;
  while (rows > 1 && bytes_of(rows) > max_shared_bytes(wanted)) rows /= 2;
  return bytes_of(rows) > max_shared_bytes(200 << 10) ? 0 : rows;
}
// Blocks of so much shared memory that run at once.
template <class S>
int64_t resident_blocks(int64_t bytes) {
  return multiprocessors() * clamp((227 << 10) / (bytes + 1024), int64_t(1), int64_t(S::kBlocks));
}

}  // namespace
}  // namespace kv::geometry::cuda
