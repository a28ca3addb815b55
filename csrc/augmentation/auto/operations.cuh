// The operations of policies on CUDA. The blocks of a plane, a cluster where the GPU has clusters, measure what its
// operation needs; most of them have nothing to do. Then a block takes a tile of a sample. All its threads do the same.
// What blocks do for a batch, for lists and for gradients.
#pragma once

#include "augmentation/auto/operations.h"
#include "color/program.cuh"
#include "core/cluster.cuh"
#include "enhance/byte_histogram.cuh"
#include "enhance/equalize.h"
#include "enhance/min_max.h"
#include "enhance/sharpness.h"
#include "geometry/transform/sample_unstaged.cuh"

namespace kv::augmentation::cuda {
namespace {

using enhance::kLevels;
using geometry::kTile;
using geometry::cuda::kThreads;
constexpr int kGroup = 4, kGroups = kTile / kGroup;  // adjacent pixels of a thread, and how many make a row of a tile
static_assert(kThreads == kLevels && kThreads == kGroups * kTile);
using Counter = enhance::LevelCounter<8>;

template <class T>
constexpr float kUnit = __is_same(T, uint8_t) ? 255.f : 1.f;  // bytes are 255ths

template <class T>
__device__ __forceinline__ int level_of(T x) {
  if constexpr (__is_same(T, uint8_t))
    return x;
  else
    return enhance::level_of(x);
}

// --- measuring -------------------------------------------------------------------------------------------------------

// The counts of all levels, one in each thread.
template <int P, class T>
__device__ __forceinline__ int count_levels(T const* plane, int64_t step, int begin, int end) {
  __shared__ __align__(16) int32_t counts[Counter::kSize];
  Counter const counter{counts};
  counter.clear<kThreads>();
  __syncthreads();
  enhance::for_each_vector<kThreads, P>(plane, step, begin, end, [&](auto const& vector, int) {
#pragma unroll
    for (T const x : vector.v) counter.add(level_of(x));
  });
  __syncthreads();
  return counter[int(threadIdx.x)];
}

// What the blocks of a plane combine: two numbers, or the counts of all levels.
template <int P, class T>
__device__ __forceinline__ void measure_part(Operation operation, T const* plane, int64_t step, int begin, int end,
                                             int32_t (&result)[kLevels]) {
  if (operation == Operation::equalize) {
    result[threadIdx.x] = count_levels<P>(plane, step, begin, end);
    return;
  }
  float sum = 0, extremes[] = {-__int_as_float(0x7f800000), -__int_as_float(0x7f800000)};  // of -x and of x
  enhance::for_each_vector<kThreads, P>(plane, step, begin, end, [&](auto const& vector, int) {
#pragma unroll
    for (T const x : vector.v) {
      float const v = read(x) * (1 / kUnit<T>);
      sum += v;
      extremes[0] = nan_max(extremes[0], -v);
      extremes[1] = nan_max(extremes[1], v);
    }
  });
  if (operation == Operation::contrast) {
    sum = block_sum<kThreads>(sum);
    if (threadIdx.x == 0) result[0] = __float_as_int(sum), result[1] = 0;
  } else {
    block_reduce<kThreads>(extremes, NanMax());
    if (threadIdx.x < 2) result[threadIdx.x] = __float_as_int(extremes[threadIdx.x]);
  }
}

// The new values of the levels, from their counts, one in each thread.
__device__ __forceinline__ void equalize_levels(int count, float* measured) {
  __shared__ int brightest;
  if (threadIdx.x == 0) brightest = 0;
  int total;
  int const up_to = enhance::block_inclusive_scan<kThreads>(count, total);
  if (count > 0 && up_to == total) brightest = count;
  __syncthreads();
  enhance::Curve const curve{false, total, 0, brightest};
  if (threadIdx.x == 0) measured[0] = curve.changes();
  if (curve.changes()) measured[2 + threadIdx.x] = float(curve(up_to, count)) / 255;
}

constexpr int64_t kSmallPlane = 8 << 10;  // pixels that one block measures

// How many pixels of a plane each of its blocks has: of a small one the first has all, so that the same are added up
// by themselves however many blocks there are.
KV_HD int pixels_of_part(int64_t pixels, int64_t parts) {
  return int(pixels > kSmallPlane ? ceil_div(ceil_div(pixels, parts), int64_t(16)) * 16 : pixels);
}

// Measures a plane of sample b, which is image `image` of x, by `parts` blocks.
template <int P, class T>
__device__ __forceinline__ void measure_plane(ApplyOperations<T> const& p, Images<T const> const& x, int64_t b,
                                              int64_t image, int channel, unsigned part, unsigned parts) {
  __shared__ int32_t results[kLevels];
  int const t = int(threadIdx.x);
  Operation const operation = p.operation_of(b);
  if (channel == 0 && part == 0 && t == 0) {
    double m[9];
    operation_matrix(operation, double(p.value_of(b)), double(x.height), double(x.width), m);
    for (int i = 0; i < 9; ++i) p.matrices[9 * b + i] = float(m[i]);
  }
  if (!measures_planes(operation)) return;  // as all blocks of the plane

  int64_t const pixels = x.height * x.width, each = pixels_of_part(pixels, parts);
  int64_t const begin = min(int64_t(part) * each, pixels);
  measure_part<P>(operation, x.row(image, channel, 0), x.step, int(begin), int(min(begin + each, pixels)), results);
  __syncthreads();
  if (parts > 1) {
    cluster_arrive();
    cluster_wait();
  }
  float* const measured = p.measured + (b * x.channels + channel) * kMeasured;
  if (part == 0) {
    auto const of_part = [&](unsigned rank, int i) { return load_of_block(&results[i], rank); };
    if (operation == Operation::equalize) {
      int count = 0;
      for (unsigned rank = 0; rank < parts; ++rank) count += of_part(rank, t);
      equalize_levels(count, measured);
    } else if (t == 0) {
      float first = __int_as_float(of_part(0, 0)), second = __int_as_float(of_part(0, 1));
      for (unsigned rank = 1; rank < parts; ++rank) {
        float const other = __int_as_float(of_part(rank, 0));
        first = operation == Operation::contrast ? first + other : nan_max(first, other);
        second = nan_max(second, __int_as_float(of_part(rank, 1)));
      }
      measured[0] = operation == Operation::contrast ? first : -first;
      measured[1] = second;
    }
  }
  if (parts > 1) {  // shared memory exists until it has been read
    cluster_arrive();
    cluster_wait();
  }
}

// --- applying --------------------------------------------------------------------------------------------------------

// A thread's pixels of a tile. Vectors, which exist as a whole, are adjacent, and so are those of stencils. Others are
// below each other, so that a warp accesses whole rows: fewer sectors of memory are filled in part. `Vectors` is a
// bool, or a type for one that is known.
template <class T, class Vectors>
struct PixelGroup {
  Vectors vectors;
  bool adjacent;
  int x, y, count;  // the first pixel, and how many exist

  __device__ __forceinline__ PixelGroup(Vectors vectors, int left, int top, int width, int height, bool is_stencil)
      : vectors(vectors), adjacent(vectors || is_stencil) {
    int const t = int(threadIdx.x);
    x = left + (adjacent ? kGroup * (t % kGroups) : t % kTile);
    y = top + (adjacent ? t / kGroups : t / kTile);
    count = x >= width || y >= height ? 0 : adjacent ? width - x : (height - y + kRows - 1) / kRows;
  }
  __device__ __forceinline__ Vector<T, kGroup> load(Images<T const> const& image, int64_t b, int channel) const {
    T const* const first = image.row(b, channel, y) + x * image.step;
    if (vectors) return *reinterpret_cast<Vector<T, kGroup> const*>(first);
    int64_t const apart = adjacent ? image.step : kRows * image.row_stride;
    Vector<T, kGroup> v{};
#pragma unroll
    for (int j = 0; j < kGroup; ++j)
      if (j < count) v.v[j] = first[j * apart];
    return v;
  }
  __device__ __forceinline__ void store(Images<T> const& image, int64_t b, int channel,
                                        Vector<T, kGroup> const& v) const {
    T* const first = image.row(b, channel, y) + x * image.step;
    if (vectors) {
      *reinterpret_cast<Vector<T, kGroup>*>(first) = v;
      return;
    }
    int64_t const apart = adjacent ? image.step : kRows * image.row_stride;
#pragma unroll
    for (int j = 0; j < kGroup; ++j)
      if (j < count) first[j * apart] = v.v[j];
  }

 private:
  static constexpr int kRows = kTile / kGroup;  // between pixels below each other
};

// Whether groups of pixels are vectors.
template <class T>
KV_HD bool has_vectors(Images<T> const& x) {
  int64_t const strides = x.row_stride | x.channel_stride | x.batch_stride | x.width;
  return x.step == 1 && strides % kGroup == 0 && reinterpret_cast<uint64_t>(x.data) % (kGroup * sizeof(T)) == 0;
}

// Sharpens a thread's pixels of row y of a plane.
template <class T>
__device__ __forceinline__ void sharpen(T const* plane, Images<T const> const& image, int x, int y, float factor,
                                        Vector<T, kGroup>& result) {
  constexpr float unit = 1 / kUnit<T>;
  int const width = int(image.width), height = int(image.height);
  float sums[kGroup] = {}, own[kGroup];
#pragma unroll
  for (int dy = -1; dy <= 1; ++dy) {
    T const* const row = plane + clamp(y + dy, 0, height - 1) * image.row_stride;
    float v[kGroup + 2];
#pragma unroll
    for (int j = 0; j < kGroup + 2; ++j) v[j] = read(row[clamp(x + j - 1, 0, width - 1) * image.step]);
#pragma unroll
    for (int j = 0; j < kGroup; ++j) {
      sums[j] += v[j] + v[j + 1] + v[j + 2];
      if (dy == 0) own[j] = v[j + 1] * unit;
    }
  }
#pragma unroll
  for (int j = 0; j < kGroup; ++j) {
    bool const is_inner = y > 0 && y + 1 < height && x + j > 0 && x + j + 1 < width;
    float const smooth = enhance::smoothed(sums[j] * unit, own[j], 0.f);
    float const v = is_inner ? enhance::sharpened(own[j], smooth, factor) : enhance::clipped(own[j], 0.f);
    result.v[j] = round_to<T>(v * kUnit<T>);
  }
}

// A thread takes C channels of its pixels at once: all of colors, or one after the other.
template <int C>
__device__ __forceinline__ int channels_of(int channels) {
  return C == kColors ? C : channels;
}
template <int C>
__device__ __forceinline__ float gray_weight(int channel, int channels) {
  return C == kColors ? luma_weight(channel) : 1 / float(channels);
}

// The mean of contrast, from what was measured of the planes of a sample.
template <int C>
__device__ __forceinline__ float mean_of(float const* measured, int channels, int64_t pixels) {
  float sum = 0;
#pragma unroll
  for (int k = 0; k < channels_of<C>(channels); ++k) sum += measured[k * kMeasured] * gray_weight<C>(k, channels);
  return sum / float(pixels);
}

// An operation on single pixels of channels from `first` on as a color step, with what was measured of the planes of
// their sample.
template <class T, int C>
__device__ __forceinline__ ColorOperation measured_operation(Operation operation, float value, float const* measured,
                                                             int first, int channels, int64_t pixels) {
  ColorOperation color = color_operation(operation, value, kPosterizeSplit<T>);
  if (operation == Operation::contrast) {
    color.parameters[1] = mean_of<C>(measured, channels, pixels);
  } else if (operation == Operation::auto_contrast) {
    float const* const own = measured + first * kMeasured;
#pragma unroll
    for (int k = 0; k < C; ++k) set_range<C>(color, k, own[k * kMeasured], own[k * kMeasured + 1]);
  }
  return color;
}

// Runs the color step of an operation, or its gradient, on `pixels` as the steps of color programs do.
template <class Pixels>
__device__ __forceinline__ void run_color(color::Step step, Pixels& pixels) {
  using color::Step;
  switch (step) {
    case Step::contrast:
      return pixels.each_value([](auto& x, int, auto const* p, auto const*) { x = color::blend(x, p[1], p[0]); });
    case Step::saturation_gray:
      if constexpr (Pixels::kChannels == kColors)
        pixels.each([](auto& c, auto const* p, auto const*) { color::saturation_gray(c, p[0]); });
      return;
    case Step::posterize:
      return pixels.each_value([](auto& x, int, auto const*, auto const* n) { x = color::posterize(x, n[0], n[1]); });
    case Step::solarize:
      return pixels.each_value(
          [](auto& x, int, auto const* p, auto const* n) { x = color::solarize(x, p[0], p[1], n[2] != 0); });
    case Step::standardize:
    case Step::standardize_rgb:
      return pixels.each_value([](auto& x, int i, auto const* p, auto const*) {
        x = (x - p[i]) * color::reciprocal(p[Pixels::kChannels + i]);
      });
    default:
      return pixels.each_value(
          [](auto& x, int, auto const* p, auto const* n) { x = color::clip(x * p[0] + p[1], n[2] != 0); });
  }
}

// What the block's sample has chosen, for the block's tile of a number, in order from 0 on.
template <int C, class T, class Vectors>
__device__ __forceinline__ void apply_to_tile(ApplyOperations<T> const& p, geometry::cuda::TileGrid const& tiles,
                                              int number, Vectors vectors) {
  __shared__ geometry::cuda::Tile<float> sampled[geometry::kMaxTilesPerBlock];
  __shared__ float tables[C][kLevels];
  geometry::cuda::Tile<float> tile;
  tile.locate(tiles, number);
  int64_t const b = tile.b;
  Images<T const> const& from = p.warp.x;
  Images<T> const& to = p.warp.y;
  int const t = int(threadIdx.x), width = int(from.width), height = int(from.height);
  int const channels = channels_of<C>(from.channels);
  Operation const operation = p.operation_of(b);
  if (moves_pixels(operation)) {
    if (number == 0) {
      if (t < int(tiles.per_block)) sampled[t].init(tiles, p.warp.coords, t);
      __syncthreads();
    }
    int const across = !vectors && sizeof(T) == 4 ? geometry::cuda::kWholeRow : geometry::cuda::kAcross<T>;
    int const x = tile.x + geometry::cuda::column_in_tile(across), y = tile.y + geometry::cuda::row_in_tile(across);
#pragma unroll 1
    for (int run = 0; run < geometry::cuda::kPixelsPerThread; ++run)
      if (x < width && y + run * geometry::cuda::kRowStep < height)
#pragma unroll 1
        for (int k = 0; k < channels; k += C)
          geometry::cuda::sample_unstaged<2, C>(p.warp, sampled[number], k, y + run * geometry::cuda::kRowStep, x);
    return;
  }
  float const* const measured = p.measured + b * channels * kMeasured;
  if (C == kColors && operation == Operation::equalize && number == 0) {
    for (int k = 0; k < C; ++k) tables[k][t] = measured[k * kMeasured + 2 + t];
    __syncthreads();
  }
  PixelGroup<T, Vectors> const group(vectors, tile.x, tile.y, width, height, operation == Operation::sharpness);
  if (group.count <= 0) return;
  float const value = p.value_of(b);
  auto const apply = [&](int first) {
    Vector<T, kGroup> stored[C];
#pragma unroll
    for (int k = 0; k < C; ++k) stored[k] = group.load(from, b, first + k);
    auto const store = [&] {
#pragma unroll
      for (int k = 0; k < C; ++k) group.store(to, b, first + k, stored[k]);
    };
    switch (operation) {
      case Operation::none:
      case Operation::identity:
        return store();
      case Operation::sharpness:
#pragma unroll
        for (int k = 0; k < C; ++k) sharpen(from.row(b, first + k, 0), from, group.x, group.y, value, stored[k]);
        return store();
      case Operation::equalize:
#pragma unroll
        for (int k = 0; k < C; ++k) {
          float const* const own = measured + (first + k) * kMeasured;
          float const* const table = C == kColors ? tables[k] : own + 2;
          bool const changes = own[0] != 0;
#pragma unroll
          for (T& pixel : stored[k].v) {
            int const level = level_of(pixel);
            if (changes && level < kLevels) pixel = round_to<T>(table[level] * kUnit<T>);
          }
        }
        return store();
      default:
        break;
    }
    int64_t const pixels = width * int64_t(height);
    ColorOperation const color = measured_operation<T, C>(operation, value, measured, first, channels, pixels);
    float c[C][kGroup];
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < kGroup; ++j) c[k][j] = read(stored[k].v[j]) * (1 / kUnit<T>);
    color::cuda::EvaluateStep<float, C, kGroup> values{c, color.parameters};
    run_color(color.step, values);
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < kGroup; ++j) stored[k].v[j] = round_to<T>(c[k][j] * kUnit<T>);
    store();
  };
#pragma unroll 1
  for (int first = 0; first < channels; first += C) apply(first);
}

// --- launching -------------------------------------------------------------------------------------------------------

// The blocks of a plane of most pixels `pixels`: a cluster where such a plane is large.
template <class... Parameters>
int64_t parts_of_planes(void (*kernel)(Parameters...), int64_t pixels) {
  return pixels > kSmallPlane && supports_clusters(kernel) ? kMaxClusterSize : 1;
}

}  // namespace
}  // namespace kv::augmentation::cuda
