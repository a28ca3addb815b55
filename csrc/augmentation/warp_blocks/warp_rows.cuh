// Warps that map rows to rows, as crops, flips and resizing do, with a program of color steps, on CUDA: of a batch, or
// of a list of images of different sizes. A block processes rows of a sample. A thread samples and colors four pixels
// of a column at a time, so that adjacent threads have adjacent pixels. What pairs of pixels a row or a column reads is
// computed once for each block.
//
// Contrast around the mean needs all pixels of a sample before any result: the blocks of a sample are a cluster, keep
// their pixels in shared memory, the last ones of each thread in its local memory, so that four blocks run at once, and
// add up the mean. No image is sampled twice.
#pragma once

#include "augmentation/lists/warp_and_color_list.h"
#include "augmentation/warp_blocks/row_taps.cuh"
#include "color/program.cuh"
#include "core/cluster.cuh"

namespace kv::augmentation::cuda {
namespace {

using color::cuda::kThreads;
constexpr int kWarps = kThreads / 32, kRows = 4;     // of the pixels of a thread
constexpr int kChannels = 3;                         // of which images of one channel use the first
constexpr int kWarpFloats = 32 * kRows * kChannels;  // of the pixels of a warp
constexpr int kLocal = 2;                            // turns whose pixels a thread keeps in its local memory

using Colors = float[kChannels][kRows];
static_assert(kRows == 4);

// What a row or a column of the result reads: two adjacent pixels of the axis, one of which may have weight 0.
struct alignas(8) AdjacentTaps {
  static constexpr int kOutside = -0x7fffffff - 1;
  // Of the first one, in elements; ~offset where the second one comes before it; kOutside where one is out of bounds.
  int offset;
  float t;  // the weight of the second one

  AdjacentTaps() = default;
  __device__ __forceinline__ AdjacentTaps(AxisTaps const& taps, int size, int stride) : t(taps.t) {
    int const first = taps.first;
    int second = taps.second;
    if (second == first) t = 0, second += first + 1 < size ? 1 : -1;
    bool const exist = unsigned(first) < unsigned(size) && unsigned(second) < unsigned(size);
    offset = !exist ? kOutside : second > first ? first * stride : ~(first * stride);
  }
  // The distance of the second pixel from the first one, where that of adjacent ones is `stride`.
  __device__ __forceinline__ int to_second(int stride) const { return offset < 0 ? -stride : stride; }
  __device__ __forceinline__ int first() const { return offset < 0 ? ~offset : offset; }
};

// Four numbers between pairs of pixels: in each, a + tx (b - a) above and below, and what is ty between them.
template <class T>
__device__ __forceinline__ float between(T const (&taps)[4], float tx, float ty, float& poison) {
  auto const mixed = [](float a, float b, float t) { return a + t * (b - a); };
  if constexpr (sizeof(T) == 1) {
    // The bits of a small integer are a float that is 2^-149 times as large. Products bring it to where sums round;
    // conversions take four times as long. Numbers are rounded to integers by a sum that has no more digits.
    constexpr float kUp = 0x1p100f, kRest = 0x1p49f, kNoDigits = 0x1.8p23f;
    float v[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) v[i] = __uint_as_float(taps[i]);
    float const above = __fmaf_rn(tx * kUp, v[1] - v[0], v[0] * kUp);
    float const below = __fmaf_rn(tx * kUp, v[3] - v[2], v[2] * kUp);
    return (__fmaf_rn(mixed(above, below, ty), kRest, kNoDigits) - kNoDigits) * (1.f / color::cuda::kScale<T>);
  } else {
    float const value = mixed(mixed(read(taps[0]), read(taps[1]), tx), mixed(read(taps[2]), read(taps[3]), tx), ty);
    poison += value * 0;
    return read(round_to<T>(value));
  }
}

// Samples a column of pixels tap by tap: where some are out of bounds, or where a tap of weight 0, which contributes
// nothing, may not be finite. Its first pixel is (x, y), and there are rows up to `last`.
template <class T, class Source>
__device__ __noinline__ void sample_by_taps(Source const& p, int64_t b, RowMap const& map, int x, int y, int last,
                                            Colors& result) {
  AxisTaps const column(p.x_axis, map.at(0, x));
#pragma unroll 1
  for (int j = 0; j < kRows; ++j) {
    AxisTaps const row(p.y_axis, map.at(1, min(y + j, last)));
#pragma unroll 1
    for (int k = 0; k < p.x.channels; ++k) {
      float sum = 0;
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        int const tap_x = i & 1 ? column.second : column.first, tap_y = i & 2 ? row.second : row.first;
        float const weight = (i & 1 ? column.t : 1 - column.t) * (i & 2 ? row.t : 1 - row.t);
        bool const exists = unsigned(tap_x) < unsigned(p.x_axis.size) && unsigned(tap_y) < unsigned(p.y_axis.size);
        if (weight != 0) sum += weight * (exists ? read(p.x.row(b, k, tap_y)[tap_x * p.x.step]) : p.fill_value(b, k));
      }
      result[k][j] = read(round_to<T>(sum)) * (1.f / color::cuda::kScale<T>);
    }
    for (int k = p.x.channels; k < kChannels; ++k) result[k][j] = 0;
  }
}

// Samples a column of pixels that reads pairs in bounds, in [0, 1]. Returns whether all taps are finite. Step 0 serves
// any image and pairs. Others are the step of the image, 1 in planes and 3 where the three channels of a pixel are
// adjacent, for pairs whose second pixel comes after the first one.
template <class T, int C, int Step, class Source>
__device__ __forceinline__ bool sample_pairs(Source const& p, int64_t b, AdjacentTaps const& column,
                                             AdjacentTaps const (&rows)[kRows], Colors& c) {
  float poison = 0;  // NaN where a tap is no finite number
  // A plane has less than 2^31 elements.
  int const row_stride = int(p.x.row_stride), across = Step ? Step : column.to_second(int(p.x.step));
#pragma unroll
  for (int k = 0; k < C; ++k) {
    // Opaque, so that the address of a tap is this and an int, not a sum in 64 bits of its own.
    size_t plane = __cvta_generic_to_global(p.x.row(b, Step == 3 ? 0 : k, 0));
    asm("" : "+l"(plane));
    T const* const from = static_cast<T const*>(__cvta_global_to_generic(plane)) + (Step == 3 ? k : 0);
    T taps[kRows][4];
#pragma unroll
    for (int j = 0; j < kRows; ++j) {
      int const offset = Step ? column.offset + rows[j].offset : column.first() + rows[j].first();
      int const down = Step ? row_stride : rows[j].to_second(row_stride);
      T const *const above = from + offset, *const below = from + (offset + down);
      taps[j][0] = above[0], taps[j][1] = above[across], taps[j][2] = below[0], taps[j][3] = below[across];
    }
#pragma unroll
    for (int j = 0; j < kRows; ++j) c[k][j] = between(taps[j], column.t, rows[j].t, poison);
  }
#pragma unroll
  for (int k = C; k < kChannels; ++k)
#pragma unroll
    for (int j = 0; j < kRows; ++j) c[k][j] = 0;
  return poison == 0;
}

// What a block needs for its part of a sample.
template <class T, class Source>
struct Sampler {
  Source const& source;
  RowMap const& map;
  int64_t b;
  int left, top, last;                 // the first column and row of the part, and the last row
  AdjacentTaps const *columns, *rows;  // of the part, those of rows up to a multiple of kRows

  // Column x and the rows from y on, in the part.
  __device__ __forceinline__ void operator()(int x, int y, Colors& c) const {
    AdjacentTaps const column = columns[x];
    AdjacentTaps of_rows[kRows];
    auto const* const vectors = reinterpret_cast<Vector<AdjacentTaps, 2> const*>(rows + y);
#pragma unroll
    for (int j = 0; j < kRows; ++j) of_rows[j] = vectors[j / 2].v[j % 2];
    auto const all_of = [&](auto holds) {
      return holds(column) && holds(of_rows[0]) && holds(of_rows[1]) && holds(of_rows[2]) && holds(of_rows[3]);
    };
    int const signs = column.offset | of_rows[0].offset | of_rows[1].offset | of_rows[2].offset | of_rows[3].offset;
    bool const ascend = __all_sync(__activemask(), signs >= 0) && source.x.channels != 1;
    int64_t const step = source.x.step;
    bool sampled = false;
    if (ascend && step == 1)
      sampled = sample_pairs<T, kChannels, 1>(source, b, column, of_rows, c);
    else if (ascend && step == 3 && source.x.channel_stride == 1)
      sampled = sample_pairs<T, kChannels, 3>(source, b, column, of_rows, c);
    else if (all_of([](AdjacentTaps const& taps) { return taps.offset != AdjacentTaps::kOutside; }))
      sampled = source.x.channels == 1 ? sample_pairs<T, 1, 0>(source, b, column, of_rows, c)
                                       : sample_pairs<T, kChannels, 0>(source, b, column, of_rows, c);
    if (!sampled) {
      Colors by_taps;  // of its own, so that `c` stays in registers
      sample_by_taps<T>(source, b, map, left + x, top + y, last, by_taps);
#pragma unroll
      for (int k = 0; k < kChannels; ++k)
#pragma unroll
        for (int j = 0; j < kRows; ++j) c[k][j] = by_taps[k][j];
    }
  }
};

// Stores a column of pixels, the first `existing` of which exist, whose first element is number i of the sample.
__device__ __forceinline__ void store_column(color::Pixels const& y, int64_t offset, int64_t i, int width, int existing,
                                             Colors const& c) {
  dispatch_dtype(y.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (color::cuda::kSupportsStorage<float, T>) {
      T* to = static_cast<T*>(y.data) + offset + i * y.step;
      int const down = width * int(y.step);
#pragma unroll
      for (int k = 0; k < kChannels; ++k, to += y.channel_stride) {
        if (k >= y.channels) break;
#pragma unroll
        for (int j = 0; j < kRows; ++j)
          if (j < existing) {
            T const value = round_to<T>(c[k][j] * color::cuda::kScale<T>);
            if constexpr (sizeof(T) == 4)
              __stcs(to + j * down, value);
            else
              to[j * down] = value;
          }
      }
    }
  });
}

template <bool FrequentOnly>
__device__ __forceinline__ void run_steps(color::cuda::Sample<float> const& sample, int begin, int end, Colors& c) {
#pragma unroll 1
  for (int s = begin; s < end; ++s) {
    auto const entry = sample.order[s];
    color::cuda::EvaluateStep<float, kChannels, kRows, FrequentOnly> values{c, sample.p + entry.first};
    color::cuda::run_entry(entry, values);
  }
}

// The image that a block samples. It is where the parameters of a batch are, and what a thread finds in those of a
// list.
template <class T>
struct BatchSource {
  using Stored = T;
  using Params = WarpAndColor<T>;
  static constexpr bool kIsFound = false;
  __device__ __forceinline__ geometry::Sample<T> const& of(WarpAndColor<T> const& p) const { return p.warp; }
};
template <class T>
struct ListSource {
  using Stored = T;
  using Params = WarpAndColorList<T>;
  static constexpr bool kIsFound = true;
  Images<T const> x;
  geometry::Axis<float> x_axis, y_axis;
  geometry::Sample<T> const* all;

  __device__ __forceinline__ void find(WarpAndColorList<T> const& p, int64_t b) {
    ListedImage const& image = p.image(b);
    all = &p.warp;
    x = images_of<T>(image, all->x.channels);
    x_axis = {image.width, all->x_axis.padding, all->x_axis.align_corners};
    y_axis = {image.height, all->y_axis.padding, all->y_axis.align_corners};
  }
  __device__ __forceinline__ ListSource const& of(WarpAndColorList<T> const&) const { return *this; }
  __device__ __forceinline__ float fill_value(int64_t b, int k) const { return all->fill_value(b, k); }
};

// The part of a sample that a block has, and the shared memory for it.
struct Parts {
  int down, across;   // in how many parts a sample is divided
  int rows, columns;  // of a part
  int kept;           // floats of pixels in shared memory
};

template <class Source, bool AroundMean, bool FrequentOnly>
__global__ void __launch_bounds__(kThreads, 4)
    warp_rows(__grid_constant__ typename Source::Params const p, Parts const parts) {
  __shared__ color::cuda::Sample<float> sample;
  __shared__ Source found;
  __shared__ RowMap map;
  __shared__ float warp_sums[kWarps];
  extern __shared__ __align__(16) float pixels[];
  int const warp = threadIdx.x / 32, lane = threadIdx.x % 32;
  unsigned const of_sample = unsigned(parts.down * parts.across), number = blockIdx.x / of_sample;
  int64_t const b = p.first_sample() + number;
  int const part = int(blockIdx.x - number * of_sample);
  int const part_y = AroundMean ? part : part / parts.across, part_x = AroundMean ? 0 : part - part_y * parts.across;
  int const top = part_y * parts.rows, left = part_x * parts.columns, width = int(p.warp.y.width);
  int const rows = max(0, min(int(p.warp.y.height) - top, parts.rows)), columns = min(width - left, parts.columns);
  int const groups = (rows + kRows - 1) / kRows, count = groups * columns;  // of pixels of a thread
  auto* const row_taps = reinterpret_cast<AdjacentTaps*>(pixels + parts.kept);
  AdjacentTaps* const column_taps = row_taps + parts.rows;

  auto const& coords = p.warp.coords;
  if (threadIdx.x == kThreads - 1) {  // not the one that prepares most of the program
    if constexpr (Source::kIsFound) found.find(p, b);
    map.init(coords.matrices + b * coords.matrix_stride, coords.use);
  }
  sample.prepare(p.program, b, false);
  auto const& source = found.of(p);
  for (int i = int(threadIdx.x); i < groups * kRows + columns; i += kThreads) {
    bool const is_row = i < groups * kRows;
    geometry::Axis<float> const axis = is_row ? source.y_axis : source.x_axis;
    int const at = is_row ? top + min(i, rows - 1) : left + i - groups * kRows;
    int const stride = int(is_row ? source.x.row_stride : source.x.step);
    (is_row ? row_taps + i : column_taps + (i - groups * kRows))[0] =
        AdjacentTaps(AxisTaps(axis, map.at(is_row ? 1 : 0, at)), axis.size, stride);
  }
  __syncthreads();

  bool const waits = AroundMean && sample.steps_before_mean < sample.length;
  // Where channels are adjacent, the pixels of a warp are stored by vectors of rows.
  bool const by_vectors = p.program.y.access != color::Access::elements;
  int64_t const to = p.program.y.offset(b);
  float* const of_warp = pixels + warp * kWarpFloats;  // those that the warp keeps first
  // Calls take(i, x, y, existing) for the pixels of the thread, the i-th of which begin at (x, y) of the part; all
  // threads of a warp call it as often.
  int const turns = max(0, (count - 32 * warp + kThreads - 1) / kThreads);
  auto const for_each_column = [&](auto take) {
    int y = int(threadIdx.x) / columns, x = int(threadIdx.x) - y * columns;
    int const down = kThreads / columns, across = kThreads - down * columns;
#pragma unroll 1
    for (int i = 0; i < turns; ++i) {
      take(i, x, kRows * y, min(rows - kRows * y, kRows));
      x += across, y += down;
      if (x >= columns) x -= columns, ++y;
    }
  };
  auto const store = [&](int x, int y, int existing, Colors& c) {
    if (!by_vectors) {
      if (existing > 0) store_column(p.program.y, to, int64_t(top + y) * width + left + x, width, existing, c);
      return;
    }
    __syncwarp();
#pragma unroll
    for (int k = 0; k < kChannels; ++k)
#pragma unroll
      for (int j = 0; j < kRows; ++j) of_warp[(k * kRows + j) * 32 + lane] = c[k][j];
    __syncwarp();
#pragma unroll
    for (int k = 0; k < kChannels; ++k) {
      auto const vector = *reinterpret_cast<Vector<float, 4> const*>(of_warp + k * kRows * 32 + 4 * lane);
#pragma unroll
      for (int j = 0; j < 4; ++j) c[k][j] = vector.v[j];
    }
    int const first = lane % 8 * 4, j = lane / 8;
    int const row_x = __shfl_sync(0xffffffffu, x, first), row_y = __shfl_sync(0xffffffffu, y, first) + j;
    int64_t const i = int64_t(top + row_y) * width + left + row_x;
    __builtin_assume(i >= 0 && i + kRows <= p.program.pixels);  // rows are whole vectors
    if (row_y < rows) color::cuda::store_pixels<false>(p.program.y, to, i, p.program.pixels, c);
  };

  Sampler<typename Source::Stored, std::decay_t<decltype(source)>> const sampler{
      source, map, b, left, top, top + rows - 1, column_taps, row_taps};
  float sum = 0;
  [[maybe_unused]] alignas(16) Colors local[kLocal];
  // Calls take(vector of channel k, k) for the pixels that the thread keeps at turn i.
  [[maybe_unused]] auto const for_each_kept = [&](int i, auto take) {
    int const at = i - turns + kLocal;
    auto* const vectors = reinterpret_cast<Vector<float, 4>*>(of_warp + i * kWarps * kWarpFloats + 4 * lane);
#pragma unroll
    for (int k = 0; k < kChannels; ++k)
      at >= 0 ? take(reinterpret_cast<Vector<float, 4>&>(local[at][k]), k) : take(vectors[k * 32], k);
  };
  for_each_column([&](int i, int x, int y, int existing) {
    Colors c{};
    if (existing > 0) sampler(x, y, c);
    run_steps<FrequentOnly>(sample, 0, sample.steps_before_mean, c);
    if (!waits) store(x, y, existing, c);
    if constexpr (AroundMean) {
      if (!waits) return;
#pragma unroll
      for (int k = 0; k < kChannels; ++k)
#pragma unroll
        for (int j = 0; j < kRows; ++j) {
          if (j < existing) sum += c[k][j] * p.program.gray_weights[k];
        }
      for_each_kept(i, [&](auto& v, int k) { v = {c[k][0], c[k][1], c[k][2], c[k][3]}; });
    }
  });
  if constexpr (AroundMean) {
    sum = warp_reduce(sum, Sum());
    if (lane == 0) warp_sums[warp] = sum;
    cluster_arrive();
    cluster_wait();
    float total = 0;
    for (int i = lane; i < kMaxClusterSize * kWarps; i += 32)
      total +=
          __int_as_float(load_of_block(reinterpret_cast<int const*>(&warp_sums[i % kWarps]), unsigned(i / kWarps)));
    total = warp_reduce(total, Sum());
    cluster_arrive();
    float const mean = total / float(p.program.mean_pixels);
    if (waits && lane == 0) sample.p[sample.mean_parameter] = mean;  // all warps write the same
    if (part == 0 && threadIdx.x == 0) p.program.means[b] = waits ? mean : 0;
    __syncwarp();
    if (waits)
      for_each_column([&](int i, int x, int y, int existing) {
        Colors c;
        for_each_kept(i, [&](auto const& v, int k) {
#pragma unroll
          for (int j = 0; j < kRows; ++j) c[k][j] = v.v[j];
        });
        run_steps<FrequentOnly>(sample, sample.steps_before_mean, sample.length, c);
        store(x, y, existing, c);
      });
    cluster_wait();  // shared memory exists until all blocks have read it
  }
}

// Rows of each block of a cluster, a multiple of those of a thread.
int64_t rows_in_cluster(int64_t height) {
  return ceil_div(ceil_div(height, int64_t(kMaxClusterSize)), int64_t(kRows)) * kRows;
}

// The floats of pixels that a block of a cluster keeps in shared memory. Each warp needs some to exchange pixels.
int64_t kept_floats(int64_t width, int64_t rows) {
  int64_t const warps = ceil_div(width * (rows / kRows), int64_t(32));
  return max(warps - kLocal * kWarps, min(warps, int64_t(kWarps))) * kWarpFloats;
}
size_t shared_bytes(int64_t kept, int64_t width, int64_t rows) {
  return size_t(kept) * sizeof(float) + size_t(rows + width) * sizeof(AdjacentTaps);
}

// Rows of a block that need not wait for others: those for which the last of as many blocks as run at once end first,
// where what a block prepares takes as long as two turns of its threads.
int64_t rows_of_block(int64_t samples, int64_t height, int64_t columns) {
  constexpr int64_t kAtOnce = 4 * 132, kPrepares = 2, kMaxRows = 1024;  // of which the pairs fit shared memory
  int64_t best = kRows, least = 0;
  for (int64_t rounds = 1; rounds <= 4; ++rounds) {
    int64_t const parts = max(int64_t(1), rounds * kAtOnce / samples);
    int64_t const rows = min(ceil_div(ceil_div(height, parts), int64_t(kRows)) * kRows, kMaxRows);
    int64_t const cost = ceil_div(samples * ceil_div(height, rows), kAtOnce) *
                         (kPrepares + ceil_div(columns * (rows / kRows), int64_t(kThreads)));
    if (least == 0 || cost < least) best = rows, least = cost;
  }
  return best;
}

// Of the samples of a batch, or of those in the table of a list.
template <class Source>
int launch_warp_rows(typename Source::Params const& params, int64_t samples, CUstream_st* stream) {
  typename Source::Params p = params;
  color::Program<float>& program = p.program;
  int64_t const height = p.warp.y.height, width = p.warp.y.width;
  bool const frequent = color::cuda::has_frequent_steps_only(program);
  if (frequent) color::cuda::invert_deviations(program);
  program.y.access = color::Access::elements;
  if (width % 4 == 0 && program.y.step != 1) color::cuda::set_access<float, 4>({&program.y}, p.warp.y.batch);
  if (program.contrast < 0) {
    constexpr int64_t kMaxColumns = 2048;  // of which the pairs fit shared memory
    int64_t const across = ceil_div(width, kMaxColumns);
    int64_t const columns = ceil_div(ceil_div(width, across), int64_t(4)) * 4;
    int64_t const rows = rows_of_block(samples * across, height, columns), down = ceil_div(height, rows);
    int64_t const kept = program.y.access == color::Access::elements ? 0 : kWarps * kWarpFloats;
    Parts const parts{int(down), int(across), int(rows), int(columns), int(kept)};
    auto* const kernel = frequent ? warp_rows<Source, false, true> : warp_rows<Source, false, false>;
    kernel<<<unsigned(samples * down * across), kThreads, shared_bytes(kept, columns, rows), stream>>>(p, parts);
    return cudaGetLastError();
  }
  program.measures_mean = true;  // no other kernel has
  int64_t const rows = rows_in_cluster(height), kept = kept_floats(width, rows);
  size_t const bytes = shared_bytes(kept, width, rows);
  auto* const kernel = frequent ? warp_rows<Source, true, true> : warp_rows<Source, true, false>;
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch_clusters(kernel, unsigned(samples * kMaxClusterSize), kThreads, bytes, kMaxClusterSize, stream, p,
                         Parts{kMaxClusterSize, 1, int(rows), int(width), int(kept)});
}

}  // namespace
}  // namespace kv::augmentation::cuda
