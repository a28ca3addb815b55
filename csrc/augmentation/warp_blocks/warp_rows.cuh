// Warps that map rows to rows, as crops, flips and resizing do, with a program of color steps, on CUDA: of a batch, or
// of a list of images of different sizes. A block processes rows of a sample, and each of its warps 32 x 4 pixels at a
// time. A thread first samples a column from global memory. Then it reads four adjacent pixels of a row from shared
// memory and applies the program to them.
//
// Contrast around the mean needs all pixels of a sample before any result: the blocks of a sample are a cluster, keep
// their pixels in shared memory, and add up the mean. No image is sampled twice.
#pragma once

#include "augmentation/lists/warp_and_color_list.h"
#include "augmentation/warp_blocks/row_taps.cuh"
#include "color/program.cuh"
#include "core/cluster.cuh"

namespace kv::augmentation::cuda {
namespace {

using color::cuda::kThreads;
constexpr int kWarps = kThreads / 32, kColumns = 32, kRows = 4;
constexpr int kStagedPixels = kColumns * kRows;  // of a warp
constexpr int kChannels = 3;                     // of which images of one channel use the first

__device__ __forceinline__ float between(float a, float b, float t) { return a + t * (b - a); }

// A thread's column of a warp's pixels in shared memory, whose rows are `pitch` apart and whose channels `plane`. There
// is memory for kRows rows, of which `rows` exist.
struct Column {
  float* to;
  int pitch, plane, rows;
};

// Samples a column tap by tap: where some are out of bounds, or where a tap of weight 0, which contributes nothing, may
// not be finite.
template <class T, class Source>
__device__ __noinline__ void sample_by_taps(Source const& p, int64_t b, AxisTaps const& column, AxisTaps const* rows,
                                            Column const& result) {
#pragma unroll 1
  for (int k = 0; k < p.x.channels; ++k) {
    float const fill = p.fill_value(b, k);
#pragma unroll 1
    for (int j = 0; j < result.rows; ++j) {
      AxisTaps const row = rows[j];
      float sum = 0;
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        int const x = i & 1 ? column.second : column.first, y = i & 2 ? row.second : row.first;
        float const weight = (i & 1 ? column.t : 1 - column.t) * (i & 2 ? row.t : 1 - row.t);
        bool const exists = unsigned(x) < unsigned(p.x_axis.size) && unsigned(y) < unsigned(p.y_axis.size);
        if (weight != 0) sum += weight * (exists ? read(p.x.row(b, k, y)[x * p.x.step]) : fill);
      }
      result.to[k * result.plane + j * result.pitch] = read(round_to<T>(sum)) * (1.f / color::cuda::kScale<T>);
    }
  }
}

// Samples a column, in [0, 1]. The source has the members of a geometry::Sample.
template <class T, class Source>
__device__ __forceinline__ void sample_column(Source const& p, int64_t b, AxisTaps const& column, AxisTaps const* rows,
                                              Column const& result) {
  int const row_stride = int(p.x.row_stride), step = int(p.x.step);  // a plane has less than 2^31 elements
  auto const is_inside = [](AxisTaps const& taps, int size) {
    return unsigned(taps.first) < unsigned(size) && unsigned(taps.second) < unsigned(size);
  };
  bool inside = is_inside(column, p.x_axis.size);
  int offsets[kRows][4];
  float t[kRows];
#pragma unroll
  for (int j = 0; j < kRows; ++j) {
    AxisTaps const row = rows[j < result.rows ? j : 0];
    inside = inside && is_inside(row, p.y_axis.size);
    t[j] = row.t;
#pragma unroll
    for (int i = 0; i < 4; ++i)
      offsets[j][i] = (i & 2 ? row.second : row.first) * row_stride + (i & 1 ? column.second : column.first) * step;
  }
  float poison = 0;  // NaN where a tap is no finite number
  if (inside) {
#pragma unroll
    for (int k = 0; k < kChannels; ++k) {
      if (k >= p.x.channels) break;
      // Opaque, so that the address of a tap is this and an int, not a sum in 64 bits of its own.
      size_t plane = __cvta_generic_to_global(p.x.row(b, k, 0));
      asm("" : "+l"(plane));
      T const* const from = static_cast<T const*>(__cvta_global_to_generic(plane));
      float taps[kRows][4];
#pragma unroll
      for (int j = 0; j < kRows; ++j)
#pragma unroll
        for (int i = 0; i < 4; ++i) taps[j][i] = read(from[offsets[j][i]]);
      float* to = result.to + k * result.plane;
#pragma unroll
      for (int j = 0; j < kRows; ++j, to += result.pitch) {
        auto const& [above, above_right, below, below_right] = taps[j];
        float const value = between(between(above, above_right, column.t), between(below, below_right, column.t), t[j]);
        if (sizeof(T) > 1) poison += value * 0;
        *to = read(round_to<T>(value)) * (1.f / color::cuda::kScale<T>);
      }
    }
  }
  if (!inside || poison != 0) sample_by_taps<T>(p, b, column, rows, result);
  for (int k = p.x.channels; k < kChannels; ++k)  // of images of one channel
    for (int j = 0; j < result.rows; ++j) result.to[k * result.plane + j * result.pitch] = 0;
}

// The four pixels of a thread among those of a warp: adjacent ones of a row, or, where rows are no whole vectors, those
// of a column.
struct OwnPixels {
  bool by_column;
  int x, y, existing;  // of the first pixel; the number of pixels within the result

  __device__ __forceinline__ OwnPixels(bool by_column, int left, int top, int width, int rows) : by_column(by_column) {
    int const lane = threadIdx.x % 32;
    x = left + (by_column ? lane : 4 * (lane % 8));
    y = top + (by_column ? 0 : lane / 8);
    existing = x >= width || y >= rows ? 0 : by_column ? min(4, rows - y) : 4;
  }
  // The pixels in shared memory, whose first one is at `at`.
  __device__ __forceinline__ void load(float const* at, int pitch, int plane, float (&c)[kChannels][4]) const {
#pragma unroll
    for (int k = 0; k < kChannels; ++k)
      if (!by_column) {
        auto const vector = *reinterpret_cast<Vector<float, 4> const*>(at + k * plane);
#pragma unroll
        for (int j = 0; j < 4; ++j) c[k][j] = vector.v[j];
      } else {
#pragma unroll
        for (int j = 0; j < 4; ++j) c[k][j] = at[k * plane + (j < existing ? j : 0) * pitch];
      }
  }
  __device__ __forceinline__ void store(float* at, int pitch, int plane, float const (&c)[kChannels][4]) const {
#pragma unroll
    for (int k = 0; k < kChannels; ++k)
      if (!by_column) {
        *reinterpret_cast<Vector<float, 4>*>(at + k * plane) = {c[k][0], c[k][1], c[k][2], c[k][3]};
      } else {
#pragma unroll
        for (int j = 0; j < 4; ++j)
          if (j < existing) at[k * plane + j * pitch] = c[k][j];
      }
  }
  // To the result, in which sample b begins at element `offset`. The first pixel is number i of the sample.
  __device__ __forceinline__ void store_result(color::Pixels const& y, int64_t offset, int64_t i, int64_t width,
                                               int64_t pixels, float const (&c)[kChannels][4]) const {
    if (!by_column) return color::cuda::store_pixels<false>(y, offset, i, pixels, c);
#pragma unroll
    for (int j = 0; j < 4; ++j) {
      float one[kChannels][1];
      for (int k = 0; k < kChannels; ++k) one[k][0] = c[k][j];
      if (j < existing) color::cuda::store_pixels<true>(y, offset, i + j * width, pixels, one);
    }
  }
};

template <bool FrequentOnly>
__device__ __forceinline__ void run_steps(color::cuda::Sample<float> const& sample, int begin, int end,
                                          float (&c)[kChannels][4]) {
#pragma unroll 1
  for (int s = begin; s < end; ++s) {
    auto const entry = sample.order[s];
    color::cuda::EvaluateStep<float, kChannels, 4, FrequentOnly> values{c, sample.p + entry.first};
    color::run_step(entry.step, values);
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
// A sample has `parts` blocks with `part_rows` rows each. Around a mean they are a cluster.
template <class Source, bool AroundMean, bool FrequentOnly>
__global__ void __launch_bounds__(kThreads, AroundMean ? 3 : 4)
    warp_rows(__grid_constant__ typename Source::Params const p, int parts, int part_rows) {
  __shared__ color::cuda::Sample<float> sample;
  __shared__ Source found;
  __shared__ RowMap map;
  __shared__ float part_sum;
  extern __shared__ __align__(16) float pixels[];
  int const width = int(p.warp.y.width), warp = threadIdx.x / 32, lane = threadIdx.x % 32;
  unsigned const number = blockIdx.x / unsigned(parts);
  int64_t const b = p.first_sample() + number;
  int const part = int(blockIdx.x - number * parts), first_row = part * part_rows;
  int const rows = max(0, min(int(p.warp.y.height) - first_row, part_rows));
  // All pixels of the block, or those of a warp.
  int const pitch = AroundMean ? width : kColumns, plane = AroundMean ? width * part_rows : kStagedPixels;
  float* const kept = pixels + (AroundMean ? 0 : warp * kChannels * plane);
  auto* const row_taps = reinterpret_cast<AxisTaps*>(pixels + (AroundMean ? 1 : kWarps) * kChannels * plane);

  auto const& coords = p.warp.coords;
  if (threadIdx.x == kThreads - 1) {  // not the one that prepares most of the program
    if constexpr (Source::kIsFound) found.find(p, b);
    map.init(coords.matrices + b * coords.matrix_stride, coords.use);
  }
  sample.prepare(p.program, b, false);
  auto const& source = found.of(p);
  for (int y = threadIdx.x; y < rows; y += kThreads) row_taps[y] = AxisTaps(source.y_axis, map.at(1, first_row + y));
  __syncthreads();

  bool const by_column = p.program.y.access == color::Access::elements;
  bool const waits = AroundMean && sample.steps_before_mean < sample.length;
  int64_t const to = p.program.y.offset(b);
  int const across = (width + kColumns - 1) / kColumns, down = (rows + kRows - 1) / kRows;
  // Calls take(pixels, those in shared memory) for the tiles of the warp, which begin at (left, top), down the columns.
  auto const for_each_tile = [&](auto sample_tile, auto take) {
    int const first = warp * across * down / kWarps, count = (warp + 1) * across * down / kWarps - first;
    int left = first / max(down, 1) * kColumns, top = first * kRows - left / kColumns * down * kRows;
#pragma unroll 1
    for (int tile = 0; tile < count; ++tile) {
      float* const at = kept + (AroundMean ? top * pitch + left : 0);
      sample_tile(left, top, at);
      OwnPixels const own(by_column, left, top, width, rows);
      if (own.existing > 0) take(own, at + (own.y - top) * pitch + (own.x - left));
      top += kRows;
      if (top >= down * kRows) top = 0, left += kColumns;
    }
  };
  auto const store_result = [&](OwnPixels const& own, float const(&c)[kChannels][4]) {
    int64_t const i = int64_t(first_row + own.y) * width + own.x;
    own.store_result(p.program.y, to, i, width, p.program.pixels, c);
  };

  float sum = 0;
  int sampled_x = -1;
  AxisTaps column{};
  for_each_tile(
      [&](int left, int top, float* at) {
        __syncwarp();  // before the previous pixels are overwritten
        int const x = left + lane;
        if (x != sampled_x) column = AxisTaps(source.x_axis, map.at(0, x));
        sampled_x = x;
        if (x < width)
          sample_column<typename Source::Stored>(source, b, column, row_taps + top,
                                                 {at + lane, pitch, plane, min(kRows, rows - top)});
        __syncwarp();
      },
      [&](OwnPixels const& own, float* at) {
        float c[kChannels][4];
        own.load(at, pitch, plane, c);
        run_steps<FrequentOnly>(sample, 0, sample.steps_before_mean, c);
        if (!waits) return store_result(own, c);
        own.store(at, pitch, plane, c);
#pragma unroll
        for (int k = 0; k < kChannels; ++k)
#pragma unroll
          for (int j = 0; j < 4; ++j)
            if (j < own.existing) sum += c[k][j] * p.program.gray_weights[k];
      });
  if constexpr (AroundMean) {
    sum = block_sum_to_all(sum, sample.sums);
    if (threadIdx.x == 0) part_sum = sum;
    __syncthreads();
    cluster_arrive();
    cluster_wait();
    if (threadIdx.x == 0) {
      float total = 0;
#pragma unroll
      for (int i = 0; i < kMaxClusterSize; ++i)
        total += __int_as_float(load_of_block(reinterpret_cast<int const*>(&part_sum), unsigned(i)));
      float const mean = total / float(p.program.mean_pixels);
      if (waits) sample.p[sample.mean_parameter] = mean;
      if (part == 0) p.program.means[b] = waits ? mean : 0;
    }
    __syncthreads();
    cluster_arrive();
    if (waits)
      for_each_tile([](int, int, float*) {},
                    [&](OwnPixels const& own, float* at) {
                      float c[kChannels][4];
                      own.load(at, pitch, plane, c);
                      run_steps<FrequentOnly>(sample, sample.steps_before_mean, sample.length, c);
                      store_result(own, c);
                    });
    __syncthreads();
    cluster_wait();  // shared memory exists until all blocks have read it
  }
}

// Shared memory of a block with as many rows.
template <bool AroundMean>
size_t shared_bytes(int64_t width, int64_t rows) {
  int64_t const kept = AroundMean ? width * rows : kWarps * kStagedPixels;
  return size_t(kept) * kChannels * sizeof(float) + size_t(rows) * sizeof(AxisTaps);
}

// Rows of each block of a cluster, a multiple of those of a tile.
int64_t rows_in_cluster(int64_t height) {
  return ceil_div(ceil_div(height, int64_t(kMaxClusterSize)), int64_t(kRows)) * kRows;
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
  if (width % 4 == 0) color::cuda::set_access<float, 4>({&program.y}, p.warp.y.batch);
  if (program.contrast < 0) {
    // More rows share what a block prepares, if there are enough for all multiprocessors.
    int64_t const rows = samples * ceil_div(height, 4 * kRows) >= 4 * 132 ? 4 * kRows : kRows;
    int64_t const parts = ceil_div(height, rows);
    size_t const bytes = shared_bytes<false>(width, rows);
    auto* const kernel = frequent ? warp_rows<Source, false, true> : warp_rows<Source, false, false>;
    kernel<<<unsigned(samples * parts), kThreads, bytes, stream>>>(p, int(parts), int(rows));
    return cudaGetLastError();
  }
  program.measures_mean = true;  // no other kernel has
  int64_t const rows = rows_in_cluster(height);
  size_t const bytes = shared_bytes<true>(width, rows);
  auto* const kernel = frequent ? warp_rows<Source, true, true> : warp_rows<Source, true, false>;
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch_clusters(kernel, unsigned(samples * kMaxClusterSize), kThreads, bytes, kMaxClusterSize, stream, p,
                         kMaxClusterSize, int(rows));
}

}  // namespace
}  // namespace kv::augmentation::cuda
