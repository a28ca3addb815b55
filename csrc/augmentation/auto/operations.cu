// The operations of policies on CUDA. The blocks of a plane, a cluster where the GPU has clusters, measure what its
// operation needs; most of them have nothing to do. Then a block takes a tile of a sample. All its threads do the same.
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

// A plane has `parts` blocks with `each` pixels.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    measure_planes(__grid_constant__ ApplyOperations<T> const p, unsigned parts, int each) {
  __shared__ int32_t results[kLevels];
  unsigned const plane = blockIdx.x / parts, part = blockIdx.x - plane * parts;
  int64_t const b = plane / kImageChannels;
  int const channel = int(plane - b * kImageChannels), t = int(threadIdx.x);
  Operation const operation = p.operation_of(b);
  Images<T const> const& x = p.warp.x;
  if (channel == 0 && part == 0 && t == 0) {
    double m[9];
    operation_matrix(operation, double(p.value_of(b)), double(x.height), double(x.width), m);
    for (int i = 0; i < 9; ++i) p.matrices[9 * b + i] = float(m[i]);
  }
  if (!measures_planes(operation)) return;  // as all blocks of the plane

  int64_t const pixels = x.height * x.width, begin = min(int64_t(part) * each, pixels);
  measure_part<P>(operation, x.row(b, channel, 0), x.step, int(begin), int(min(begin + each, pixels)), results);
  __syncthreads();
  if (parts > 1) {
    cluster_arrive();
    cluster_wait();
  }
  float* const measured = p.measured + int64_t(plane) * kMeasured;
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

// A thread's adjacent pixels of a row, at column x; `count` of them exist. As vectors, all do.
template <class T, bool Vectors>
struct PixelGroup {
  int x, count;

  __device__ __forceinline__ Vector<T, kGroup> load(T const* row, int64_t step) const {
    if constexpr (Vectors) return *reinterpret_cast<Vector<T, kGroup> const*>(row + x);
    Vector<T, kGroup> v{};
#pragma unroll
    for (int j = 0; j < kGroup; ++j)
      if (j < count) v.v[j] = row[(x + j) * step];
    return v;
  }
  __device__ __forceinline__ void store(T* row, int64_t step, Vector<T, kGroup> const& v) const {
    if constexpr (Vectors) {
      *reinterpret_cast<Vector<T, kGroup>*>(row + x) = v;
    } else {
#pragma unroll
      for (int j = 0; j < kGroup; ++j)
        if (j < count) row[(x + j) * step] = v.v[j];
    }
  }
};

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

// The mean of contrast, from what was measured of the planes of a sample.
__device__ __forceinline__ float mean_of(float const* measured, int64_t pixels) {
  float sum = 0;
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k) sum += measured[k * kMeasured] * luma_weight(k);
  return sum / float(pixels);
}

// An operation on single pixels as a color step, with what was measured of the planes of its sample.
template <class T>
__device__ __forceinline__ ColorOperation measured_operation(Operation operation, float value, float const* measured,
                                                             int64_t pixels) {
  ColorOperation color = color_operation(operation, value, kPosterizeSplit<T>);
  if (operation == Operation::contrast) {
    color.parameters[1] = mean_of(measured, pixels);
  } else if (operation == Operation::auto_contrast) {
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k) set_range(color, k, measured[k * kMeasured], measured[k * kMeasured + 1]);
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
      return pixels.each([](auto& c, auto const* p, auto const*) { color::saturation_gray(c, p[0]); });
    case Step::posterize:
      return pixels.each_value([](auto& x, int, auto const*, auto const* n) { x = color::posterize(x, n[0], n[1]); });
    case Step::solarize:
      return pixels.each_value(
          [](auto& x, int, auto const* p, auto const* n) { x = color::solarize(x, p[0], p[1], n[2] != 0); });
    case Step::standardize_rgb:
      return pixels.each_value(
          [](auto& x, int i, auto const* p, auto const*) { x = (x - p[i]) * color::reciprocal(p[3 + i]); });
    default:
      return pixels.each_value(
          [](auto& x, int, auto const* p, auto const* n) { x = color::clip(x * p[0] + p[1], n[2] != 0); });
  }
}

template <class T, bool Vectors>
__global__ void __launch_bounds__(kThreads, 4)
    apply_to_tiles(__grid_constant__ ApplyOperations<T> const p, geometry::cuda::TileGrid tiles) {
  __shared__ geometry::cuda::Tile<float> sampled;
  __shared__ float tables[kImageChannels][kLevels];
  geometry::cuda::Tile<float> tile;
  tile.locate(tiles, 0);
  int64_t const b = tile.b;
  Images<T const> const& from = p.warp.x;
  Images<T> const& to = p.warp.y;
  int const t = int(threadIdx.x), width = int(from.width), height = int(from.height);
  Operation const operation = p.operation_of(b);
  if (moves_pixels(operation)) {
    if (t == 0) sampled.init(tiles, p.warp.coords);
    __syncthreads();
    int const x = tile.x + geometry::cuda::column_in_tile<T>(), y = tile.y + geometry::cuda::row_in_tile<T>();
#pragma unroll 1
    for (int run = 0; run < geometry::cuda::kPixelsPerThread; ++run)
      if (x < width && y + run * geometry::cuda::kRowStep < height)
        geometry::cuda::sample_unstaged<2, kImageChannels>(p.warp, sampled, 0, y + run * geometry::cuda::kRowStep, x);
    return;
  }
  float const* const measured = p.measured + b * kImageChannels * kMeasured;
  if (operation == Operation::equalize) {
    for (int k = 0; k < kImageChannels; ++k) tables[k][t] = measured[k * kMeasured + 2 + t];
    __syncthreads();
  }
  int const x = tile.x + kGroup * (t % kGroups), y = tile.y + t / kGroups;
  if (x >= width || y >= height) return;
  PixelGroup<T, Vectors> const group{x, min(kGroup, width - x)};
  Vector<T, kGroup> stored[kImageChannels];
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k) stored[k] = group.load(from.row(b, k, y), from.step);
  auto const store = [&] {
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k) group.store(to.row(b, k, y), to.step, stored[k]);
  };
  float const value = p.value_of(b);
  switch (operation) {
    case Operation::none:
    case Operation::identity:
      return store();
    case Operation::sharpness:
#pragma unroll
      for (int k = 0; k < kImageChannels; ++k) sharpen(from.row(b, k, 0), from, x, y, value, stored[k]);
      return store();
    case Operation::equalize:
#pragma unroll
      for (int k = 0; k < kImageChannels; ++k) {
        bool const changes = measured[k * kMeasured] != 0;
#pragma unroll
        for (T& pixel : stored[k].v) {
          int const level = level_of(pixel);
          if (changes && level < kLevels) pixel = round_to<T>(tables[k][level] * kUnit<T>);
        }
      }
      return store();
    default:
      break;
  }
  ColorOperation const color = measured_operation<T>(operation, value, measured, width * int64_t(height));
  float c[kImageChannels][kGroup];
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k)
#pragma unroll
    for (int j = 0; j < kGroup; ++j) c[k][j] = read(stored[k].v[j]) * (1 / kUnit<T>);
  color::cuda::EvaluateStep<float, kImageChannels, kGroup> pixels{c, color.parameters};
  run_color(color.step, pixels);
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k)
#pragma unroll
    for (int j = 0; j < kGroup; ++j) stored[k].v[j] = round_to<T>(c[k][j] * kUnit<T>);
  store();
}

// --- gradients -------------------------------------------------------------------------------------------------------

// The sums of a plane, for operations that need some: kGradientSums numbers, added up by the blocks of the plane.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    sum_gradients(__grid_constant__ ApplyOperationsBackward<T> const p, unsigned parts, int each) {
  __shared__ int32_t results[kGradientSums];
  unsigned const plane = blockIdx.x / parts, part = blockIdx.x - plane * parts;
  int64_t const b = plane / kImageChannels;
  int const channel = int(plane - b * kImageChannels), t = int(threadIdx.x);
  Operation const operation = p.forward.operation_of(b);
  if (operation != Operation::contrast && operation != Operation::auto_contrast) return;  // as all blocks of the plane

  Images<T const> const& x = p.forward.warp.x;
  int64_t const pixels = x.height * x.width, begin = min(int64_t(part) * each, pixels);
  float const* const measured = p.forward.measured + b * kImageChannels * kMeasured;
  T const* const grad = p.warp.grad.row(b, channel, 0);
  float const mean = mean_of(measured, pixels), factor = p.forward.value_of(b);
  float const lowest = measured[channel * kMeasured], highest = measured[channel * kMeasured + 1];
  float sums[kGradientSums] = {};
  enhance::for_each_vector<kThreads, P>(x.row(b, channel, 0), 1, int(begin), int(min(begin + each, pixels)),
                                        [&](auto const& vector, int i) {
                                          int j = 0;
#pragma unroll
                                          for (T const stored : vector.v) {
                                            float const v = read(stored), g = read(grad[i + j++]);
                                            if (operation == Operation::contrast) {
                                              sums[0] += color::blend_vjp_gray(v, g, mean, factor);
                                            } else {
                                              sums[0] += g, sums[1] += g * (v - lowest);
                                              sums[2] += v == lowest, sums[3] += v == highest;
                                            }
                                          }
                                        });
  block_reduce<kThreads>(sums, Sum());
  if (t == 0)
#pragma unroll
    for (int i = 0; i < kGradientSums; ++i) results[i] = __float_as_int(sums[i]);
  __syncthreads();
  if (parts > 1) {
    cluster_arrive();
    cluster_wait();
  }
  if (part == 0 && t < kGradientSums) {
    float sum = 0;
    for (unsigned rank = 0; rank < parts; ++rank) sum += __int_as_float(load_of_block(&results[t], rank));
    p.sums[int64_t(plane) * kGradientSums + t] = sum;
  }
  if (parts > 1) {  // shared memory exists until it has been read
    cluster_arrive();
    cluster_wait();
  }
}

// The gradient of a thread's pixels that sharpen() makes: of row y of a plane from column x on. Image and gradient are
// dense. The gradient of a pixel goes to the 3 x 3 pixels around it, which depends on the 5 x 5 pixels of the image.
template <class T>
__device__ __forceinline__ void sharpen_vjp(T const* plane, T const* grad, int height, int width, int x, int y,
                                            float factor, Vector<T, kGroup>& result) {
  float pixels[5][kGroup + 4], lines[5][kGroup + 2];  // from column x - 2 on; sums of three, from x - 1 on
#pragma unroll
  for (int r = 0; r < 5; ++r) {
    T const* const row = plane + clamp(y + r - 2, 0, height - 1) * width;
#pragma unroll
    for (int j = 0; j < kGroup + 4; ++j) pixels[r][j] = read(row[clamp(x + j - 2, 0, width - 1)]);
#pragma unroll
    for (int j = 0; j < kGroup + 2; ++j) lines[r][j] = pixels[r][j] + pixels[r][j + 1] + pixels[r][j + 2];
  }
  float own[kGroup], around[kGroup] = {};
#pragma unroll
  for (int r = 0; r < 3; ++r) {
    int const from_y = y + r - 1;
    if (from_y < 0 || from_y >= height) continue;
#pragma unroll
    for (int j = 0; j < kGroup + 2; ++j) {
      int const from_x = x + j - 1;
      if (from_x < 0 || from_x >= width) continue;
      float const v = pixels[r + 1][j + 1], g = read(grad[from_y * width + from_x]);
      float const smooth = enhance::smoothed(lines[r][j] + lines[r + 1][j] + lines[r + 2][j], v, 0.f);
      bool const is_inner = from_y > 0 && from_y + 1 < height && from_x > 0 && from_x + 1 < width;
      enhance::SharpenedVjp<float> of{enhance::clipped_vjp(v, g, 0.f), 0, 0};
      if (is_inner) of = enhance::sharpened_vjp(v, smooth, g, factor);
      if (r == 1 && j >= 1 && j <= kGroup) own[j - 1] = of.own + enhance::smoothed(0.f, of.around, 0.f);
#pragma unroll
      for (int i = max(j - 2, 0); i <= min(j, kGroup - 1); ++i) around[i] += of.around;
    }
  }
#pragma unroll
  for (int i = 0; i < kGroup; ++i) result.v[i] = round_to<T>(own[i] + enhance::smoothed(around[i], 0.f, 0.f));
}

// Operations that move pixels, and those that do nothing, have their gradients from the warp.
template <class T, bool Vectors>
__global__ void __launch_bounds__(kThreads, 3)
    apply_to_gradients(__grid_constant__ ApplyOperationsBackward<T> const p, geometry::cuda::TileGrid tiles) {
  geometry::cuda::Tile<float> tile;
  tile.locate(tiles, 0);
  int64_t const b = tile.b;
  Images<T const> const &from = p.forward.warp.x, &grad = p.warp.grad;
  Images<T> const& to = p.warp.grad_x;
  int const t = int(threadIdx.x), width = int(from.width), height = int(from.height);
  Operation const operation = p.forward.operation_of(b);
  if (moves_pixels(operation) || operation == Operation::none || operation == Operation::identity) return;
  int const x = tile.x + kGroup * (t % kGroups), y = tile.y + t / kGroups;
  if (x >= width || y >= height) return;
  PixelGroup<T, Vectors> const group{x, min(kGroup, width - x)};
  float const* const measured = p.forward.measured + b * kImageChannels * kMeasured;
  float const value = p.forward.value_of(b);
  Vector<T, kGroup> result[kImageChannels];
  auto const store = [&] {
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k) group.store(to.row(b, k, y), 1, result[k]);
  };
  if (operation == Operation::sharpness) {
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k)
      sharpen_vjp(from.row(b, k, 0), grad.row(b, k, 0), height, width, x, y, value, result[k]);
    return store();
  }
  Vector<T, kGroup> stored[kImageChannels];
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k) {
    stored[k] = group.load(from.row(b, k, y), 1);
    result[k] = group.load(grad.row(b, k, y), 1);
  }
  if (operation == Operation::equalize) {  // levels have none
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k) {
      bool const changes = measured[k * kMeasured] != 0;
#pragma unroll
      for (int j = 0; j < kGroup; ++j)
        if (changes && level_of(stored[k].v[j]) < kLevels) result[k].v[j] = round_to<T>(0.f);
    }
    return store();
  }
  int64_t const pixels = width * int64_t(height);
  ColorOperation const color = measured_operation<T>(operation, value, measured, pixels);
  float c[kImageChannels][kGroup], g[kImageChannels][kGroup];
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k)
#pragma unroll
    for (int j = 0; j < kGroup; ++j) c[k][j] = read(stored[k].v[j]), g[k][j] = read(result[k].v[j]);
  color::cuda::StepInputGradient<float, kImageChannels, kGroup> gradient{c, g, color.parameters};
  run_color(color.step, gradient);
  float const* const sums = p.sums + b * kImageChannels * kGradientSums;
  if (operation == Operation::contrast) {
    float of_mean = 0;
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k) of_mean += sums[k * kGradientSums];
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k)
#pragma unroll
      for (int j = 0; j < kGroup; ++j) g[k][j] += of_mean / float(pixels) * luma_weight(k);
  } else if (operation == Operation::auto_contrast) {
#pragma unroll
    for (int k = 0; k < kImageChannels; ++k) {
      float const lowest = measured[k * kMeasured], highest = measured[k * kMeasured + 1];
      float const* const own = sums + k * kGradientSums;
      if (lowest == highest) continue;
      enhance::RangeGradient<float> const of_range({own[0], own[1], own[2], own[3]}, lowest, highest, 1.f, kRangeEps);
#pragma unroll
      for (int j = 0; j < kGroup; ++j) {
        if (c[k][j] == lowest) g[k][j] += of_range.grad_smallest;
        if (c[k][j] == highest) g[k][j] += of_range.grad_largest;
      }
    }
  }
#pragma unroll
  for (int k = 0; k < kImageChannels; ++k)
#pragma unroll
    for (int j = 0; j < kGroup; ++j) result[k].v[j] = round_to<T>(g[k][j]);
  store();
}

// --- launching -------------------------------------------------------------------------------------------------------

// Whether groups of pixels are vectors.
template <class T>
bool has_vectors(Images<T> const& x) {
  int64_t const strides = x.row_stride | x.channel_stride | x.batch_stride | x.width;
  return x.step == 1 && strides % kGroup == 0 && reinterpret_cast<uintptr_t>(x.data) % (kGroup * sizeof(T)) == 0;
}

constexpr int64_t kSmallPlane = 8 << 10;  // pixels that one block measures

// Launches a kernel that takes all planes of the images x, by clusters where planes are large.
template <class Params, class T>
int launch_for_planes(void (*kernel)(Params, unsigned, int), Params const& p, Images<T const> const& x,
                      CUstream_st* stream) {
  int64_t const pixels = x.height * x.width;
  bool const divides = pixels > kSmallPlane && supports_clusters(kernel);
  int64_t const parts = divides ? kMaxClusterSize : 1, each = ceil_div(ceil_div(pixels, parts), int64_t(16)) * 16;
  return launch_clusters(kernel, unsigned(x.batch * kImageChannels * parts), kThreads, 0, unsigned(parts), stream, p,
                         unsigned(parts), int(each));
}
template <class T>
int launch_measuring(ApplyOperations<T> const& p, CUstream_st* stream) {
  constexpr int P = enhance::kRowVector<T>;
  return launch_for_planes(p.warp.x.step == 1 ? measure_planes<T, P> : measure_planes<T, 1>, p, p.warp.x, stream);
}

template <class T>
__global__ void __launch_bounds__(kThreads) choose(__grid_constant__ ChooseOperations<T> const p, int64_t steps) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < steps) p.choose(i);
}

}  // namespace

template <class T>
int apply_operations(ApplyOperations<T> const& p, CUstream_st* stream) {
  Images<T const> const& x = p.warp.x;
  if (int const error = launch_measuring(p, stream)) return error;
  geometry::cuda::TileGrid const tiles(x.batch, x.height, x.width, 1);
  auto* const kernel = has_vectors(x) && has_vectors(p.warp.y) ? apply_to_tiles<T, true> : apply_to_tiles<T, false>;
  kernel<<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int apply_operations_backward(ApplyOperationsBackward<T> const& p, CUstream_st* stream) {
  Images<T const> const& x = p.forward.warp.x;
  if (int const error = launch_measuring(p.forward, stream)) return error;
  if (int const error = geometry::cuda::sample_image_backward(p.warp, stream)) return error;
  if (int const error = launch_for_planes(sum_gradients<T, enhance::kRowVector<T>>, p, x, stream)) return error;
  geometry::cuda::TileGrid const tiles(x.batch, x.height, x.width, 1);
  bool const vectors = has_vectors(x) && has_vectors(p.warp.grad) && has_vectors(p.warp.grad_x);
  auto* const kernel = vectors ? apply_to_gradients<T, true> : apply_to_gradients<T, false>;
  kernel<<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int choose_operations(ChooseOperations<T> const& p, CUstream_st* stream) {
  int64_t const steps = p.batch * p.count * p.length;
  choose<<<unsigned(ceil_div(steps, int64_t(kThreads))), kThreads, 0, stream>>>(p, steps);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, float)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, uint8_t)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::BFloat16)
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, float)
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, ::kv::BFloat16)
KV_INSTANTIATE_ONE(choose_operations, ChooseOperations, float)

}  // namespace kv::augmentation::cuda
