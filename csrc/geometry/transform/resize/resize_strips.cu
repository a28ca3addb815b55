// Resizing of any kind by any factor on CUDA, and its backward pass.
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
#include <cuda_pipeline.h>

#include "core/block_reduce.cuh"
#include "core/launch.cuh"
#include "core/row_prefetcher.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kWarps = 8, kThreads = 32 * kWarps;
constexpr int kMaxElements = 256;  // of the result in a row of a strip
constexpr int kBlocks = 3;         // on a multiprocessor at once

// M: the most windows that hold a row, where the image shrinks, or the most rows in a window, where it grows.
template <class T, int M, bool Shrinks>
struct StripOf {
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
// a block, in any order of its warps.
__device__ __forceinline__ void write_norms(ResizeAxis const& axis, int thread, float* norms, int from, int count) {
  int const group = axis.max_readers > 8 ? 8 : 2, all = (count + 31) / 32 * 32 * group;  // `group` threads a pixel
#pragma unroll 1
  for (int t = thread; t < all; t += kThreads) {
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
  __device__ __forceinline__ void write(ResizeAxis const& axis, int thread) const {
    int const group = axis.max_taps > 8 ? 8 : 1;  // threads that share an entry
#pragma unroll 1
    for (int t = thread; t < slots * group; t += kThreads) {
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

template <class T, int M, bool Shrinks>
__global__ void __launch_bounds__(kThreads, kBlocks)
    resize_strips(__grid_constant__ Resize<T> const p, ResizeStrips const strips, bool aligned) {
  using S = StripOf<T, M, Shrinks>;
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32, step = int(p.x.step);
  unsigned const q = blockIdx.x / strips.across, group = q / strips.down;
  int const e0 = int(blockIdx.x - q * strips.across) * strips.elements;
  int const elements = min(strips.elements, int(p.y.row_size()) - e0), padded = (elements + 31) & -32;
  int const taps_x = p.columns.max_taps, taps_y = p.rows.max_taps, height = int(p.y.height);
  int const block_y = int(q - group * strips.down) * strips.rows * strips.warps_down;
  int const table_rows = strips.rows * strips.warps_down, row_slots = (table_rows + 31) & -32;
  int const planes_per_block = kWarps / strips.warps_down;
  int64_t const plane = int64_t(group) * planes_per_block + warp / strips.warps_down;
  int const first_row = warp % strips.warps_down * strips.rows, y0 = block_y + first_row;  // of the warp
  int const rows = plane < p.y.count() ? min(strips.rows, height - y0) : 0;

  // Rings, lines, tables.
  extern __shared__ __align__(16) unsigned char memory[];
  int const columns_padded = (strips.elements + 31) & -32;
  float* const all_lines = reinterpret_cast<float*>(memory + kWarps * S::kWarpBytes);
  float* const lines = all_lines + warp * strips.lines;
  // Of a row of x in the rows of the result that it is part of, by their numbers modulo M.
  float* const weights_of_rows = all_lines + kWarps * strips.lines;
  float* const weights_x = weights_of_rows + (Shrinks ? strips.warps_down * strips.span_y * S::kSlots : 0);
  int* const first_x = reinterpret_cast<int*>(weights_x + taps_x * columns_padded);
  int* const end_x = first_x + columns_padded;
  float* const weights_y = reinterpret_cast<float*>(end_x + columns_padded);
  int* const first_y = reinterpret_cast<int*>(weights_y + taps_y * row_slots);
  int* const end_y = first_y + row_slots;
  float* const norms_x = reinterpret_cast<float*>(end_y + row_slots);
  float* const norms_y = norms_x + (p.columns.backward ? S::kSpan : 0);

  // The pixels that the strip, the warp and the block read: each thread finds one end.
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

  // The ring of rows, in which a row begins at a word as it does in the image.
  int const stride = int(p.x.row_stride * sizeof(T));
  T const* const column = p.x.plane(rows > 0 ? plane : 0) + from;
  unsigned char* const ring = memory + warp * S::kWarpBytes;
  auto const past_word = [&](int y) {
    return sizeof(T) == 4 ? 0 : int(reinterpret_cast<uintptr_t>(column) + unsigned(y) * unsigned(stride)) & 3;
  };
  int unsafe_from = 0;
  if (sizeof(T) < 4 && rows > 0)
    unsafe_from = first_unsafe_row<4 / int(sizeof(T))>(p.x, p.x.plane(plane), p.x.row_size());
  int next = from_y;
  auto const fetch = [&] {
    if (next < to_y) {
      auto const to = uint32_t(__cvta_generic_to_shared(ring)) + (next & (S::kRing - 1)) * S::kRowBytes;
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
  };
  for (int i = 16 * lane; i < S::kWarpBytes; i += 512) *reinterpret_cast<uint4*>(ring + i) = uint4{};
  for (int i = S::kLines * S::kSpan + lane; i < strips.lines; i += 32) lines[i] = 0;  // read with weight 0
  __syncwarp();
  if (rows > 0)
#pragma unroll 1
    for (int i = 0; i < (Shrinks ? S::kRing - 1 : S::kRing); ++i) fetch();

  // The weights. The last warps begin with those of rows.
  int const thread_of_rows = 32 * (kWarps - 1 - warp) + lane;
  if (p.columns.backward) {
    write_norms(p.columns, threadIdx.x, norms_x, from_x, min(to_x - from_x, S::kSpan));
    write_norms(p.rows, thread_of_rows, norms_y, block_from_y, block_to_y - block_from_y);
    __syncthreads();
  }
  int const last_row = min(block_y + table_rows, height) - 1;
  WeightTable const columns{e0 / step, last_x, step, padded, weights_x, 1, padded, first_x, end_x, norms_x, from_x};
  columns.write(p.columns, threadIdx.x);
  WeightTable const of_rows{block_y, last_row, 1,     row_slots, weights_y,   taps_y,
                            1,       first_y,  end_y, norms_y,   block_from_y};
  of_rows.write(p.rows, thread_of_rows);
  if constexpr (Shrinks)
    for (int i = threadIdx.x; i < strips.warps_down * strips.span_y * S::kSlots; i += kThreads) weights_of_rows[i] = 0;
  __syncthreads();
  for (int i = threadIdx.x; i < padded; i += kThreads) {
    int const e = e0 + min(i, elements - 1);
    first_x[i] = min(first_x[i] * step + e % step - from, S::kSpan);
  }
  if constexpr (Shrinks) {
    int const count = min(table_rows, height - block_y);
    for (int i = threadIdx.x; i < count * taps_y; i += kThreads) {
      int const r = i / taps_y, k = i - r * taps_y, strip = r / strips.rows, y = first_y[r] + k;
      int const at = y - first_y[strip * strips.rows];
      if (y < end_y[r] && at < strips.span_y)
        weights_of_rows[(strip * strips.span_y + at) * S::kSlots + (r - strip * strips.rows) % M] = weights_y[i];
    }
  }
  __syncthreads();
  if (rows <= 0) return;

  T* out = p.y.row(plane, y0) + e0;
  // The pixels of `count` rows of the result from the lines of sums. Taps: the number of weights, or 0 for any.
  auto const write_rows = [&](int count, auto taps) {
    int const K = taps.value ? taps.value : taps_x;
#pragma unroll 1
    for (int c = lane; c < padded; c += 32) {
      float sums[S::kLines] = {};
      float const *values = lines + first_x[c], *weight = weights_x + c;
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
          if (float const of_tap = weights_x[k * padded + c]; of_tap != 0)
#pragma unroll
            for (int j = 0; j < S::kLines; ++j) sums[j] += of_tap * lines[first_x[c] + k * step + j * S::kSpan];
      }
      if (c >= elements) break;
      T* to = out + c;
#pragma unroll
      for (int j = 0; j < S::kLines; ++j, to += p.y.row_stride)
        if (j < count) *to = round_to<T>(p.minuend ? float(read(*p.minuend_at(to))) - sums[j] : sums[j]);
    }
  };
  auto const write = [&](int count) {
    __syncwarp();
    if (taps_x == 2)
      write_rows(count, std::integral_constant<int, 2>{});
    else if (taps_x == 3)
      write_rows(count, std::integral_constant<int, 3>{});
    else if (taps_x == 4)
      write_rows(count, std::integral_constant<int, 4>{});
    else if (taps_x == 5)
      write_rows(count, std::integral_constant<int, 5>{});
    else
      write_rows(count, std::integral_constant<int, 0>{});
    out += count * p.y.row_stride;
    __syncwarp();
  };
  auto const add = [&](float(&sums)[S::kColumns], float weight, float const(&pixels)[S::kColumns]) {
    if (weight != 0) {
#pragma unroll
      for (int i = 0; i < S::kColumns; ++i) sums[i] += weight * pixels[i];
    }
  };
  auto const store_line = [&](int j, float const(&sums)[S::kColumns]) {
    constexpr int P = 4;
#pragma unroll
    for (int i = 0; i < S::kColumns; i += P) {
      Vector<float, P> vector;
#pragma unroll
      for (int n = 0; n < P; ++n) vector.v[n] = sums[i + n];
      *reinterpret_cast<Vector<float, P>*>(lines + j * S::kSpan + 32 * i + P * lane) = vector;
    }
  };
  auto const read_row = [&](int y, float(&pixels)[S::kColumns]) {
    read_pixels<S>(reinterpret_cast<T const*>(ring + (y & (S::kRing - 1)) * S::kRowBytes), aligned ? 0 : past_word(y),
                   pixels);
  };

  if constexpr (Shrinks) {
    float sums[M][S::kColumns] = {};
    auto const* weights =
        reinterpret_cast<Vector<float, S::kSlots> const*>(weights_of_rows) + warp % strips.warps_down * strips.span_y;
    int y = from_y;
#pragma unroll 1
    for (int r = 0; r < rows; r += S::kLines) {
#pragma unroll
      for (int j = 0; j < S::kLines; ++j) {
        int const end = r + j < rows ? end_y[first_row + r + j] : 0;
#pragma unroll 1
        for (; y < end; ++y, ++weights) {
          __pipeline_wait_prior(S::kAhead);
          __syncwarp();
          fetch();
          float pixels[S::kColumns];
          read_row(y, pixels);
          Vector<float, S::kSlots> const of_row = *weights;
#pragma unroll
          for (int s = 0; s < M; ++s) add(sums[s], of_row.v[s], pixels);
        }
        store_line(j, sums[j % M]);
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
        int const row = first_row + r + j, first = first_y[row], end = end_y[row];
        while (next < end + S::kAhead) fetch();
        __pipeline_wait_prior(S::kAhead);
        __syncwarp();
        float sums[S::kColumns] = {};
#pragma unroll
        for (int k = 0; k < M; ++k) {
          if (first + k >= end) break;
          float pixels[S::kColumns];
          read_row(first + k, pixels);
          add(sums, weights_y[row * taps_y + k], pixels);
        }
        store_line(j, sums);
        __syncwarp();
      }
      write(min(S::kLines, rows - r));
    }
  }
}

// --- launches --------------------------------------------------------------------------------------------------------

// The most adjacent pixels of a row of the output that read at most `span` adjacent ones.
inline int64_t pixels_of_span(ResizeAxis const& a, int64_t span) {
  int64_t const step = a.backward ? a.den : a.num, unit = a.backward ? a.num : a.den;  // a pixel of y, and one of x
  int64_t const band = a.has_window() ? 2 * filter_radius(a.filter) * a.unit : (a.max_taps + 1) * unit;
  if (span * unit < band) return 0;
  return step ? (span * unit - band) / step + 1 : INT64_MAX;
}

template <class T, int M, bool Shrinks>
int launch(Resize<T> const& p, CUstream_st* stream) {
  using S = StripOf<T, M, Shrinks>;
  bool const aligned = reinterpret_cast<uintptr_t>(p.x.data) % 16 == 0 && p.x.row_stride % S::kVector == 0 &&
                       p.x.inner_stride % S::kVector == 0 && p.x.outer_stride % S::kVector == 0 &&
                       p.x.row_size() % S::kVector == 0;
  int64_t const step = p.x.step, planes = p.y.count();
  // A strip that does not begin with a whole vector or word copies some elements before its first one.
  int64_t const before = aligned ? S::kVector - 1 : 4 / int(sizeof(T)) - 1;
  bool const whole = p.x.row_size() <= S::kSpan - (aligned ? 0 : before);
  int64_t const max_columns = min(whole ? p.y.width : pixels_of_span(p.columns, (S::kSpan - before) / step),
                                  max(kMaxElements / step, int64_t(1)));
  if (max_columns == 0 || step > kMaxElements) return kUnsupported;
  ResizeStrips strips;
  strips.across = unsigned(ceil_div(p.y.width, max_columns));
  strips.elements = int(ceil_div(p.y.width, strips.across) * step);
  // Planes side by side in a block share its weights, unless too many warps had none.
  strips.warps_down = 1;
  while ((-planes & (kWarps / strips.warps_down - 1)) * 8 > planes) strips.warps_down *= 2;
  strips.lines = (S::kLines * S::kSpan + int(p.columns.max_taps * step) + 4) & -4;
  int64_t const taps_x = p.columns.max_taps, taps_y = p.rows.max_taps;
  auto const rows_read = [&](int64_t rows) {
    int64_t const to = p.rows.backward ? p.rows.den : p.rows.num, from = p.rows.backward ? p.rows.num : p.rows.den;
    return min(from ? ceil_div(rows * to, from) + taps_y + 1 : p.x.height, p.x.height);
  };
  auto const bytes_of = [&](int64_t rows) {
    int64_t const slots = (rows * strips.warps_down + 31) & -32, padded = (strips.elements + 31) & -32;
    int64_t const norms = p.rows.backward ? S::kSpan + rows_read(rows * strips.warps_down) : 0;
    int64_t const of_rows = Shrinks ? strips.warps_down * rows_read(rows) * S::kSlots : 0;
    return kWarps * (S::kWarpBytes + 4 * int64_t(strips.lines)) +
           4 * ((taps_x + 2) * padded + (taps_y + 2) * slots + norms + of_rows);
  };
  int64_t rows = 64;
  while (rows > 1 && bytes_of(rows) > max_shared_bytes(100 << 10)) rows /= 2;
  if (bytes_of(rows) > max_shared_bytes(200 << 10)) return kUnsupported;
  int64_t const per_multiprocessor = clamp((227 << 10) / (bytes_of(rows) + 1024), int64_t(1), int64_t(kBlocks));
  int64_t const resident = multiprocessors() * per_multiprocessor * kWarps;
  rows = min(rows, int64_t(strip_height(planes * strips.across, p.y.height, 6, resident, resident)));
  strips.rows = int(rows);
  strips.span_y = int(rows_read(rows));
  strips.down = unsigned(ceil_div(p.y.height, rows * strips.warps_down));
  int64_t const bytes = bytes_of(rows);
  auto const kernel = resize_strips<T, M, Shrinks>;
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  unsigned const blocks = unsigned(ceil_div(planes, kWarps / strips.warps_down)) * strips.across * strips.down;
  kernel<<<blocks, kThreads, unsigned(bytes), stream>>>(p, strips, aligned);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int resize_strips(Resize<T> const& p, CUstream_st* stream) {
  if (p.x.row_stride * int64_t(sizeof(T)) > INT32_MAX) return kUnsupported;
  bool const shrinks = p.rows.max_readers <= p.rows.max_taps;
  int const taps = shrinks ? p.rows.max_readers : p.rows.max_taps;
  if (taps <= 2) return shrinks ? launch<T, 2, true>(p, stream) : launch<T, 2, false>(p, stream);
  if (taps <= 4) return shrinks ? launch<T, 4, true>(p, stream) : launch<T, 4, false>(p, stream);
  if (taps <= 6) return shrinks ? launch<T, 6, true>(p, stream) : launch<T, 6, false>(p, stream);
  return kUnsupported;
}

template int resize_strips(Resize<float> const&, CUstream_st*);
template int resize_strips(Resize<Half> const&, CUstream_st*);
template int resize_strips(Resize<BFloat16> const&, CUstream_st*);
template int resize_strips(Resize<uint8_t> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
