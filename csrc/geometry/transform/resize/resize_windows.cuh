// Antialiased resizing of windows on CUDA, and its gradient, for batches and lists. A block has a tile of the output of
// one sample, some planes of it. Backward, the output is the gradient of the image; it is 0 outside of the window.
//
//   weights   The block computes those of its columns and of its rows once.
//   down      A thread has a column of the output, and its weights in registers. It goes down the rows of the input:
//             each is weighted along x once, and then along y, for the rows of the output that read it.
//
// A mirrored window has the same weights in reverse order: positions in the tile are mirrored, nothing else is.
#pragma once

#include "core/launch.cuh"
#include "geometry/transform/resize/contributors.cuh"
#include "geometry/transform/resize/resize_windows.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;               // at most, of a block
constexpr int kMaxColumns = kThreads;       // of a tile; columns count elements
constexpr int kMinRows = 4, kMaxRows = 32;  // of a tile
constexpr int kMaxRowsOfFloats = 16;        // forward; H200: views of MultiCrop 1.12 times as fast
constexpr int kAhead = 2;                   // rows that a thread reads before it needs them
constexpr int kPlanes = 3;                  // of a thread, if samples have so many or a multiple of them
constexpr int kBlocks = 4;                  // on a multiprocessor at once, of the most threads
constexpr int64_t kShared = 54 << 10;       // of each

// How the output is divided among blocks, and the capacities of their shared memory in numbers.
struct WindowTiles {
  unsigned across, down, groups;  // tiles of columns and of rows, groups of planes
  int columns, rows;              // of a tile; columns in pixels
  int weights, steps;             // of all columns, of the rows
  int64_t bytes;
};

// Pixels that a pixel reads.
struct Reads {
  int first, count;
  __device__ int last() const { return first + count - 1; }
};

// One axis of a sample's window: the numbers of ResizeAxis in 32 bits, which suffice for tiles. A block computes many.
struct WindowAxis {
  ResizeFilter filter;
  bool backward, mirrored;
  int first, source, result;  // of the window; sizes of the window and of what it is resized to
  int origin, num, den, unit, reach;
  float per_den, per_num, per_unit;
  int max_taps;  // that a pixel of the output reads

  __device__ WindowAxis(Window const& window, ResizeFilter filter, int result, bool align_corners, bool backward)
      : filter(filter),
        backward(backward),
        mirrored(window.mirrored),
        first(window.first),
        source(window.size),
        result(result),
        origin(align_corners ? 0 : source - result),
        num(!align_corners ? 2 * source
            : result > 1   ? source - 1
                           : 0),
        den(!align_corners ? 2 * result
            : result > 1   ? result - 1
                           : 1),
        unit(max(num, den)),
        reach(filter_radius(filter) * unit),
        per_den(1 / float(den)),
        per_num(num ? 1 / float(num) : 0),
        per_unit(unit == den ? per_den : per_num) {
    max_taps = !backward ? min(rounded_down(2 * reach + den - 1, den, per_den), source)
               : num     ? min(rounded_down(2 * reach + num - 1, num, per_num), result)
                         : result;
  }
  // The quotient is not above 2^22.
  static __device__ __forceinline__ int rounded_down(int n, int divisor, float reciprocal) {
    int const q = __float2int_rd(float(n) * reciprocal), rest = n - q * divisor;
    return rest < 0 ? q - 1 : rest < divisor ? q : q + 1;
  }

  // Where the axis begins in the input and in the output, and its length there.
  __device__ int in_first() const { return backward ? 0 : first; }
  __device__ int out_first() const { return backward ? first : 0; }
  __device__ int in_size() const { return backward ? result : source; }
  __device__ int out_size() const { return backward ? source : result; }
  // Positions of the output, and indices along the axis.
  __device__ int index_of(int position) const {
    int const i = position - out_first();
    return mirrored ? out_size() - 1 - i : i;
  }
  // As window_band and window_holders.
  __device__ __forceinline__ Reads band(int i) const {
    int const n = origin + i * num;
    int const from = max(rounded_down(n - reach, den, per_den) + 1, 0);
    return {from, min(rounded_down(n + reach - 1, den, per_den), source - 1) - from + 1};
  }
  __device__ __forceinline__ Reads reads(int index) const {
    if (!backward) return band(index);
    if (num == 0) return {0, result};  // all read the only pixel
    int const n = index * den - origin;
    int const from = clamp(rounded_down(n - reach, num, per_num) + 1, 0, result);
    return {from, max(min(rounded_down(n + reach - 1, num, per_num), result - 1) - from + 1, 0)};
  }
  // The first of as many pixels as any index reads, which are all within the input.
  __device__ int first_tap(Reads const& reads) const { return clamp(reads.first, 0, in_size() - max_taps); }
  // The weight of source pixel j in pixel i of the result, before it is divided by their sum.
  __device__ __forceinline__ float weight(int i, int j) const {
    float const x = float(j * den - (origin + i * num)) * per_unit;
    return filter == ResizeFilter::bilinear ? __saturatef(1 - fabsf(x)) : call_filter(filter, x);
  }
  static __device__ __noinline__ float call_filter(ResizeFilter filter, float x) { return filter_at(filter, true, x); }
};

// The part of an axis that a tile covers.
struct TileAxis {
  int begin, end;    // positions of the output within the window
  int low, count;    // indices of the axis
  int from, length;  // the pixels of the axis that they read
  int taps;

  __device__ __forceinline__ void init(WindowAxis const& a, int first, int last) {
    begin = max(first, a.out_first());
    end = min(last, a.out_first() + a.out_size());
    count = max(end - begin, 0);
    low = from = length = 0;
    taps = a.max_taps;
    if (count == 0) return;
    low = min(a.index_of(begin), a.index_of(end - 1));
    from = a.first_tap(a.reads(low));
    length = a.first_tap(a.reads(low + count - 1)) + taps - from;
  }
  __device__ __forceinline__ bool covers(int position) const { return position >= begin && position < end; }
};

// 1 / the sum of weights, of the pixels of the result that a part of an axis reads backward.
__device__ __forceinline__ void write_norms(WindowAxis const& a, TileAxis const& tile, float* norms, int thread,
                                            int threads) {
  for (int t = thread; t < tile.length; t += threads) {
    int const i = tile.from + t;
    Reads const band = a.band(i);
    float sum = 0;
#pragma unroll 1
    for (int j = band.first; j <= band.last(); ++j) sum += a.weight(i, j);
    norms[t] = 1 / sum;
  }
}

// The weight of pixel `at` of the input, which pixel `index` of the output reads; forward before it is divided by their
// sum.
__device__ __forceinline__ float tap_weight(WindowAxis const& a, TileAxis const& tile, float const* norms, int index,
                                            int at) {
  return a.backward ? a.weight(at, index) * norms[at - tile.from] : a.weight(index, at);
}

// Weight k of column i at [k * count + i], and the first pixel that it reads.
__device__ __forceinline__ void write_weights(WindowAxis const& a, TileAxis const& tile, float const* norms,
                                              float* weights, int* first, int thread, int threads) {
  int const each = a.backward && tile.taps > 8 ? 8 : 1;  // threads of a column
#pragma unroll 1
  for (int t = thread; t < tile.count * each; t += threads) {
    int const local = t / each, index = tile.low + local;
    Reads const reads = a.reads(index);
    int const begin = a.first_tap(reads), end = reads.first + reads.count;
    float* const to = weights + local;
    float sum = 0;
#pragma unroll 1
    for (int k = t % each; k < tile.taps; k += each) {
      int const at = begin + k;
      float const weight = at >= reads.first && at < end ? tap_weight(a, tile, norms, index, at) : 0;
      to[k * tile.count] = weight;
      sum += weight;
    }
    if (!a.backward) {
      float const norm = 1 / sum;
#pragma unroll 1
      for (int k = 0; k < tile.taps; ++k) to[k * tile.count] *= norm;
    }
    first[local] = begin - tile.from;
  }
}

// What happens at a row, for a window of radius R. Where pixels have at most 2 R taps, it is a row of the output: the
// weights of the last rows of the input, and the number of the last one. Where pixels have more, each row of the input
// is read by at most 2 R rows of the output. Then it is a row of the input: its weights in the rows of the output that
// are not complete, and how many it completes.
template <int R>
struct alignas(16) RowStep {
  float weights[2 * R];
  int number;
};

// The steps of a tile's rows. Rows of the input are 0 before.
template <int R>
__device__ __forceinline__ void write_steps(WindowAxis const& a, TileAxis const& tile, float const* norms,
                                            RowStep<R>* steps, int thread, int threads) {
  bool const by_output = tile.taps <= 2 * R;
#pragma unroll 1
  for (int t = thread; t < tile.count; t += threads) {
    int const index = tile.low + t;
    Reads const reads = a.reads(index);
    int const begin = a.first_tap(reads), end = reads.first + reads.count;
    int last[2 * R - 1];  // of the rows of the output before this one
#pragma unroll
    for (int i = 0; i < 2 * R - 1; ++i) {
      last[i] = INT32_MIN;
      if (by_output || t <= i) continue;
      last[i] = a.reads(index - 1 - i).last();
    }
    auto const weight_at = [&](int at) -> float& {
      if (by_output) return steps[t].weights[at - begin + 2 * R - tile.taps];
      int incomplete = 0;
#pragma unroll
      for (int i = 0; i < 2 * R - 1; ++i) incomplete += last[i] >= at;
      return steps[at - tile.from].weights[incomplete];
    };
    if (by_output) {
#pragma unroll
      for (int i = 0; i < 2 * R; ++i) steps[t].weights[i] = 0;
      steps[t].number = begin - tile.from + tile.taps - 1;
    }
    float sum = 0;
#pragma unroll 1
    for (int at = reads.first; at < end; ++at) sum += weight_at(at) = tap_weight(a, tile, norms, index, at);
    if (!a.backward) {
      float const norm = 1 / sum;
#pragma unroll 1
      for (int at = reads.first; at < end; ++at) weight_at(at) *= norm;
    }
    if (!by_output) atomicAdd(&steps[end - 1 - tile.from].number, 1);
  }
  if (by_output && thread == 0) steps[tile.count].number = INT32_MAX;
}

// The sum of all taps of a pixel, the weights computed as they are needed. A tap of weight 0 contributes nothing, even
// if it is inf or NaN. `plane` is the first pixel of the input.
template <class T>
__device__ __noinline__ Compute<T> sum_of_taps(ResizeWindows<T> const& p, int64_t sample, int index_x, int index_y,
                                               T const* plane) {
  using F = Compute<T>;
  int const index[] = {index_x, index_y};
  int64_t const stride[] = {p.one_number ? 0 : p.x.step, p.x.row_stride};
  if (p.one_number) plane = p.x.data;
  ResizeAxis axes[] = {p.resize_axis(p.window(sample, 0), 0), p.resize_axis(p.window(sample, 1), 1)};
  Contributors<F> reads[2];
#pragma unroll 1
  for (int a = 0; a < 2; ++a) {
    reads[a] = find_contributors<F>(axes[a], index[a]);
    plane += (reads[a].first + (p.backward ? 0 : p.window(sample, a).first)) * stride[a];
  }
  F sum = 0;
  for (int l = 0; l < reads[0].count; ++l) {
    F const weight_x = find_weight(axes[0], reads[0], index_x, l);
    F line = 0;
    for (int k = 0; k < reads[1].count && weight_x != 0; ++k) {
      F const weight = find_weight(axes[1], reads[1], index_y, k);
      if (weight != 0) line += F(read(plane[k * stride[1] + l * stride[0]])) * weight;
    }
    if (weight_x != 0) sum += line * weight_x;
  }
  return sum;
}

// The tile of a block, and its tables in shared memory. Its phases are in the order in which they run.
template <class T, int P, int R>
struct WindowTile {
  ResizeWindows<T> const& p;
  WindowAxis const &across, &down;
  TileAxis const &columns, &rows;
  int x, y, end_x, end_y, step;
  int64_t sample, x_plane0, plane0;
  int x_plane, y_plane;  // elements between planes
  T const* origin;       // the first element that the tile reads
  RowStep<R>* steps;
  float* weights_x;
  int* first_x;

  __device__ __forceinline__ int elements() const { return (end_x - x) * step; }  // of a row
  __device__ __forceinline__ bool is_empty() const { return columns.count == 0 || rows.count == 0; }
  __device__ __forceinline__ bool by_output() const { return rows.taps <= 2 * R; }

  // The rows of the tile are on their way to the L2 cache while the weights are computed.
  __device__ __forceinline__ void prefetch() const {
    int const lines = (columns.length * step * int(sizeof(T)) + 254) / 128;
    for (int t = int(threadIdx.x); t < lines * rows.length * P; t += int(blockDim.x)) {
      int const row = t / lines, line = t - row * lines;
      int const k = P == 1 ? 0 : row % P, r = P == 1 ? row : row / P;
      auto const* const at = reinterpret_cast<char const*>(origin + k * x_plane + r * p.x.row_stride) +
                             min(128 * line, columns.length * step * int(sizeof(T)) - 1);
      asm volatile("prefetch.global.L2 [%0];" ::"l"(at));
    }
  }

  // The weights of columns and the steps of rows. The last threads begin with rows.
  __device__ __forceinline__ void write_tables(float* norms_x) const {
    int const threads = int(blockDim.x), from_last = threads - 1 - int(threadIdx.x);
    float* const norms_y = norms_x + columns.length;
    if (p.backward) {
      write_norms(across, columns, norms_x, int(threadIdx.x), threads);
      write_norms(down, rows, norms_y, from_last, threads);
    }
    if (!by_output())
      for (int t = int(threadIdx.x); t < rows.length; t += threads) steps[t] = {};
    if (p.backward || !by_output()) __syncthreads();
    write_weights(across, columns, norms_x, weights_x, first_x, int(threadIdx.x), threads);
    write_steps(down, rows, norms_y, steps, from_last, threads);
    __syncthreads();
  }

  // Element e of the rows.
  __device__ __forceinline__ void write_column(int e, int pixel) const {
    int const index_x = across.index_of(x + pixel), local = index_x - columns.low;
    T const* const from = origin + first_x[local] * step + (e - pixel * step);
    bool const backwards = down.mirrored;
    int const to_stride = int(backwards ? -p.y.row_stride : p.y.row_stride);
    T* const to = p.y.row(plane0, backwards ? rows.end - 1 : rows.begin) + int64_t(x) * step + e;
    bool const one_number = sizeof(T) > 1 && p.one_number;  // bytes have no gradient
    float const poison = one_number    ? walk_number(weights_x + local, to, to_stride)
                         : by_output() ? walk_by_taps<true>(from, weights_x + local, to, to_stride)
                                       : walk_by_taps<false>(from, weights_x + local, to, to_stride);
    // A tap of weight 0 contributes nothing, even if it is inf or NaN.
    if (poison != 0) write_exactly(to, to_stride, index_x, p.x.plane(x_plane0) + (e - pixel * step));
  }
  template <bool StepsOfOutput>
  __device__ __forceinline__ float walk_by_taps(T const* from, float const* weights, T* to, int to_stride) const {
    if (columns.taps == 2 * R) return walk<2 * R, StepsOfOutput>(from, weights, to, to_stride);
    if (columns.taps == 2 * R + 1) return walk<2 * R + 1, StepsOfOutput>(from, weights, to, to_stride);
    if (R == 1 && columns.taps == 4) return walk<4, StepsOfOutput>(from, weights, to, to_stride);
    if (R == 1 && columns.taps == 5) return walk<5, StepsOfOutput>(from, weights, to, to_stride);
    if (R == 1 && columns.taps == 6) return walk<6, StepsOfOutput>(from, weights, to, to_stride);
    if (R == 1 && columns.taps == 7) return walk<7, StepsOfOutput>(from, weights, to, to_stride);
    return walk<0, StepsOfOutput>(from, weights, to, to_stride);
  }
  // Goes down the rows of the input, K taps a pixel (0: any number). What is not 0 has met inf or NaN.
  template <int K, bool StepsOfOutput>
  __device__ __forceinline__ float walk(T const* from, float const* all_weights, T* to, int to_stride) const {
    constexpr int D = K == 0 || K > 4 ? 1 : kAhead, N = K > 0 ? K : 1;
    int const length = rows.length, row_stride = int(p.x.row_stride);
    float weights[N], poison = 0;
#pragma unroll
    for (int n = 0; n < K; ++n) weights[n] = all_weights[n * columns.count];
    T raw[D][P][N];
    auto const load = [&](T(&into)[P][N]) {
#pragma unroll
      for (int k = 0; k < P; ++k) {
        T const* const row = from + k * x_plane;
#pragma unroll
        for (int n = 0; n < K; ++n) into[k][n] = row[n * step];
      }
      from += row_stride;
    };
    if constexpr (K > 0) {
#pragma unroll
      for (int d = 0; d < D; ++d)
        if (d < length) load(raw[d]);
    }
    auto const store = [&](float const(&sums)[P]) {
#pragma unroll
      for (int k = 0; k < P; ++k) to[k * y_plane] = round_to<T>(sums[k]);
      to += to_stride;
    };
    float sums[2 * R][P]{};  // the last rows of the input, or rows of the output that are not complete
    RowStep<R> const* next = steps;
    RowStep<R> own = *next;
#pragma unroll 1
    for (int r = 0; r < length;) {
#pragma unroll
      for (int d = 0; d < D; ++d, ++r) {
        if (d > 0 && r >= length) break;
        float h[P]{};
        if constexpr (K > 0) {
#pragma unroll
          for (int k = 0; k < P; ++k)
#pragma unroll
            for (int n = 0; n < K; ++n) h[k] += weights[n] * read(raw[d][k][n]);
          if (r + D < length) load(raw[d]);
        } else {
#pragma unroll 4
          for (int n = 0; n < columns.taps; ++n) {
            float const weight = all_weights[n * columns.count];
#pragma unroll
            for (int k = 0; k < P; ++k) h[k] += weight * read(from[k * x_plane + n * step]);
          }
          from += row_stride;
        }
        if constexpr (sizeof(T) > 1) {
#pragma unroll
          for (int k = 0; k < P; ++k) poison += h[k] * 0;
        }
        auto const shift = [&](float const(&last)[P]) {
#pragma unroll
          for (int i = 0; i < 2 * R; ++i)
#pragma unroll
            for (int k = 0; k < P; ++k) sums[i][k] = i + 1 < 2 * R ? sums[min(i + 1, 2 * R - 1)][k] : last[k];
        };
        if constexpr (StepsOfOutput) {
          shift(h);
#pragma unroll 1
          while (own.number == r) {
            float pixels[P]{};
#pragma unroll
            for (int i = 0; i < 2 * R; ++i)
#pragma unroll
              for (int k = 0; k < P; ++k) pixels[k] += own.weights[i] * sums[i][k];
            own = *++next;
            store(pixels);
          }
        } else {
#pragma unroll
          for (int i = 0; i < 2 * R; ++i)
#pragma unroll
            for (int k = 0; k < P; ++k) sums[i][k] += own.weights[i] * h[k];
#pragma unroll 1
          for (; own.number > 0; --own.number) {
            store(sums[0]);
            float const zeros[P]{};
            shift(zeros);
          }
          own = *++next;
        }
      }
    }
    return poison;
  }
  // The same where all elements of the input are one number, with the same bits.
  __device__ __forceinline__ float walk_number(float const* weights, T* to, int to_stride) const {
    float const number = read(*p.x.data);
    float line = 0;
    for (int n = 0; n < columns.taps; ++n) line += weights[n * columns.count] * number;
    auto const store = [&](float sum) {
#pragma unroll
      for (int k = 0; k < P; ++k) to[k * y_plane] = round_to<T>(sum);
      to += to_stride;
    };
    if (by_output()) {
#pragma unroll 2
      for (int t = 0; t < rows.count; ++t) {
        float sum = 0;
#pragma unroll
        for (int i = 0; i < 2 * R; ++i) sum += steps[t].weights[i] * line;
        store(sum);
      }
    } else {
      float sums[2 * R]{};
#pragma unroll 1
      for (int r = 0; r < rows.length; ++r) {
#pragma unroll
        for (int i = 0; i < 2 * R; ++i) sums[i] += steps[r].weights[i] * line;
#pragma unroll 1
        for (int complete = steps[r].number; complete > 0; --complete) {
          store(sums[0]);
#pragma unroll
          for (int i = 0; i < 2 * R; ++i) sums[i] = i + 1 < 2 * R ? sums[min(i + 1, 2 * R - 1)] : 0;
        }
      }
    }
    return line * 0;
  }
  __device__ __forceinline__ void write_exactly(T* to, int to_stride, int index_x, T const* source) const {
#pragma unroll 1
    for (int i = 0; i < rows.count; ++i, to += to_stride)
#pragma unroll 1
      for (int k = 0; k < P; ++k)
        to[k * y_plane] = round_to<T>(sum_of_taps(p, sample, index_x, rows.low + i, source + k * x_plane));
  }

  // Clears the pixels of the tile that are not in the window.
  __device__ __forceinline__ void clear_outside(int e, int pixel) const {
    if (!is_empty() && columns.count == end_x - x && rows.count == end_y - y) return;
    if (e >= elements()) return;
    bool const in_columns = !is_empty() && columns.covers(x + pixel);
    for (int k = 0; k < P; ++k) {
      T* const out = p.y.plane(plane0 + k) + int64_t(x) * step + e;
      for (int row = y; row < end_y; ++row)
        if (!in_columns || !rows.covers(row)) out[row * p.y.row_stride] = T{};
    }
  }
};

// Block number `block` of the tiles of all samples.
template <class T, int P, int R>
__device__ __forceinline__ void resize_tile(ResizeWindows<T> const& p, WindowTiles const& tiles, unsigned block) {
  __shared__ __align__(16) unsigned char axes_memory[2 * sizeof(WindowAxis)];
  __shared__ TileAxis tile_axes[2];
  extern __shared__ __align__(16) float memory[];
  WindowAxis* const axes = reinterpret_cast<WindowAxis*>(axes_memory);
  int const step = P == 1 ? int(p.x.step) : 1;

  unsigned rest = block;
  int const x = int(rest % tiles.across) * tiles.columns;
  rest /= tiles.across;
  int const y = int(rest % tiles.down) * tiles.rows;
  rest /= tiles.down;
  int64_t const sample = p.sample_of(rest / tiles.groups), group = rest % tiles.groups * P;
  int64_t const x_plane0 = p.image_of(sample) * p.planes + group, plane0 = sample * p.planes + group;
  int const end_x = min(x + tiles.columns, int(p.y.width)), end_y = min(y + tiles.rows, int(p.y.height));
  if (threadIdx.x < 2) {
    int const i = int(threadIdx.x);
    axes[i] = {p.window(sample, i), p.filter, p.result(i), p.align_corners, p.backward};
    tile_axes[i].init(axes[i], i ? y : x, i ? end_y : end_x);
  }
  __syncthreads();
  RowStep<R>* const steps = reinterpret_cast<RowStep<R>*>(memory);
  float* const weights_x = reinterpret_cast<float*>(steps + tiles.steps);
  int* const first_x = reinterpret_cast<int*>(weights_x + tiles.weights);
  T const* const origin = p.x.plane(x_plane0) + int64_t(axes[1].in_first() + tile_axes[1].from) * p.x.row_stride +
                          int64_t(axes[0].in_first() + tile_axes[0].from) * step;
  int const x_plane = P > 1 ? int(p.x.plane(x_plane0 + 1) - p.x.plane(x_plane0)) : 0;
  int const y_plane = P > 1 ? int(p.y.plane(plane0 + 1) - p.y.plane(plane0)) : 0;
  WindowTile<T, P, R> const tile{p,       axes[0], axes[1], tile_axes[0], tile_axes[1], x,      y,
                                 end_x,   end_y,   step,    sample,       x_plane0,     plane0, x_plane,
                                 y_plane, origin,  steps,   weights_x,    first_x};
  int const e = int(threadIdx.x), pixel = step == 1 ? e : e / step;
  if (!tile.is_empty()) {
    if (!p.one_number) tile.prefetch();
    tile.write_tables(reinterpret_cast<float*>(first_x + tiles.columns));
    if (e < tile.elements() && tile.columns.covers(x + pixel)) tile.write_column(e, pixel);
  }
  if (p.backward) tile.clear_outside(e, pixel);
}

// --- any types and sizes: one thread an element, the weights computed as they are needed -----------------------------

constexpr int kElements = 256;  // of a block

template <class T>
__device__ __forceinline__ void resize_element(ResizeWindows<T> const& p, unsigned block) {
  int64_t const i = int64_t(block) * kElements + threadIdx.x, size = p.y.row_size(), step = p.x.step;
  if (i >= p.y.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.y.height, sample = plane / p.planes;
  int const position[] = {int(e / step), int(r - plane * p.y.height)};
  int index[2];
  bool inside = true;
#pragma unroll 1
  for (int a = 0; a < 2; ++a) {
    Window const window = p.window(sample, a);
    int const size = p.backward ? window.size : p.result(a);
    index[a] = position[a] - (p.backward ? window.first : 0);
    inside = inside && index[a] >= 0 && index[a] < size;
    if (window.mirrored) index[a] = size - 1 - index[a];
  }
  T const* const first = p.x.plane(plane + (p.image_of(sample) - sample) * p.planes) + (e - position[0] * step);
  p.y.row(plane, position[1])[e] = round_to<T>(inside ? sum_of_taps(p, sample, index[0], index[1], first) : 0);
}

// --- launches --------------------------------------------------------------------------------------------------------

// Tiles that serve windows of any size: the largest windows read most.
template <class T>
WindowTiles tiles_of(ResizeWindows<T> const& p, int planes, int64_t step_bytes) {
  int64_t const step = p.x.step, width = p.y.width, height = p.y.height, radius = filter_radius(p.filter);
  ResizeAxis const across(p.filter, p.source(0), p.result(0), p.align_corners, true, false);
  ResizeAxis const down(p.filter, p.source(1), p.result(1), p.align_corners, true, false);
  // As equal as possible.
  auto const divided = [](int64_t size, int64_t most) { return ceil_div(size, ceil_div(size, most)); };
  int64_t const columns = divided(width, max(kMaxColumns / step, int64_t(1)));
  // So many rows that all blocks are a few times as many as run at once: the smaller a type is, the more of the time is
  // spent on weights, which rows share.
  int64_t const groups = ceil_div(p.planes, planes), samples = p.y.count() / p.planes;
  int64_t const all_rows = samples * groups * ceil_div(width, columns) * height;
  int64_t const waves = (sizeof(T) == 4 ? 4 : sizeof(T) == 2 ? 3 : 2) + (p.backward ? 1 : 0);
  int64_t const most = sizeof(T) == 4 && !p.backward ? kMaxRowsOfFloats : kMaxRows;
  int64_t const rows =
      divided(height, clamp(all_rows / (waves * kBlocks * multiprocessors()), int64_t(kMinRows), most));
  // Backward, s pixels of a window are read by each of `result` ones, and by at most 2 radius result + s ones in all if
  // s is larger than 2 radius.
  int64_t const weights =
      p.backward ? (2 * radius + 1) * max(int64_t(across.result), columns) + columns : columns * across.max_taps;
  int64_t const rows_read = p.backward
                                ? int64_t(down.result)
                                : min(ceil_div(rows * down.num, down.den) + down.max_taps + 1, int64_t(down.source));
  int64_t const steps = max(rows_read, rows) + 1, norms = p.backward ? int64_t(across.result) + down.result : 0;
  return {unsigned(ceil_div(width, columns)),
          unsigned(ceil_div(height, rows)),
          unsigned(groups),
          int(columns),
          int(rows),
          int(weights),
          int(steps),
          step_bytes * steps + 4 * (weights + columns + norms)};
}

// Offsets between planes have 32 bits where a thread takes several.
template <class P>
bool has_near_planes(P const& images) {
  return images.plane(1) - images.plane(0) <= INT32_MAX / kPlanes;
}
// Coordinates of tiles have 32 bits, and their quotients 22.
inline bool fits_coordinates(int64_t source, int64_t result) {
  return max(source, result) < 1 << 22 && source * result <= INT32_MAX / 4;
}
template <class T>
bool fits_coordinates(ResizeWindows<T> const& p) {
  return fits_coordinates(p.source(0), p.result(0)) && fits_coordinates(p.source(1), p.result(1));
}
// Whether the kernel of tiles takes images.
template <class P>
bool fits_tiles(P const& images) {
  return images.step <= kMaxColumns && images.height * images.row_stride <= INT32_MAX;
}

// Calls run(P, tiles, threads, R) for windows whose tiles have room in shared memory; else returns kUnsupported.
template <class T, class Run>
int dispatch_tiles(ResizeWindows<T> const& p, bool by_groups, Run run) {
  auto const with_radius = [&](auto radius) -> int {
    constexpr int R = decltype(radius)::value;
    WindowTiles const tiles = tiles_of(p, by_groups ? kPlanes : 1, sizeof(RowStep<R>));
    if (tiles.bytes > max_shared_bytes(kShared)) return kUnsupported;
    int const threads = int(ceil_div(tiles.columns * p.x.step, int64_t(32))) * 32;
    if (by_groups) return run(std::integral_constant<int, kPlanes>{}, radius, tiles, threads);
    return run(std::integral_constant<int, 1>{}, radius, tiles, threads);
  };
  return p.filter == ResizeFilter::bilinear  ? with_radius(std::integral_constant<int, 1>{})
         : p.filter == ResizeFilter::bicubic ? with_radius(std::integral_constant<int, 2>{})
                                             : with_radius(std::integral_constant<int, 3>{});
}

}  // namespace
}  // namespace kv::geometry::cuda
