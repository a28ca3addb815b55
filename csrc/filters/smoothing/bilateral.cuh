// Shared by the CUDA kernels of the bilateral blur.
//
// Images of 1 or 3 channels that are their own guides and are computed in float32 are processed in tiles in shared
// memory; all others by plain kernels.
#pragma once

#include "bilateral.h"
#include "core/launch.cuh"

namespace kv::filters::cuda {
namespace {

// The pixel at position i, or -1 for the constant 0. With the circular border it may be more than one image away.
__device__ __forceinline__ int pixel_at(Border border, int i, int n) {
  if (border != Border::circular) return border_index(border, i, n);
  int const r = i % n;
  return r < 0 ? r + n : r;
}

// --- tiles -----------------------------------------------------------------------------------------------------------

// Blocks of 256 threads, tiles of 64 columns. A thread computes a run of `Run` pixels below each other.
constexpr int kThreads = 256, kColumns = 64;
constexpr int rows_of(int run) { return kThreads / kColumns * run; }

// The division of an image batch into tiles, one for each block.
template <int Run>
struct Tiles {
  unsigned across, down, count;
  Tiles(int64_t batch, int64_t height, int64_t width)
      : across(unsigned(ceil_div(width, kColumns))),
        down(unsigned(ceil_div(height, rows_of(Run)))),
        count(unsigned(batch * across * down)) {}
  __device__ __forceinline__ void locate(int64_t& b, int& y, int& x) const {
    unsigned const q = blockIdx.x / across, image = q / down;
    x = int(blockIdx.x - q * across) * kColumns;
    y = int(q - image * down) * rows_of(Run);
    b = image;
  }
};

// Whether blocks of a kernel can have this much shared memory. Raises the kernel's limit where it exceeds the default.
template <class Kernel>
bool fits(Kernel kernel, int64_t bytes) {
  if (bytes <= 48 << 10) return true;
  return bytes <= max_shared_bytes() &&
         cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)) == cudaSuccess;
}

// Planes of floats in shared memory, whose element (0, 0) is pixel (y, x) of the image.
struct SharedPlanes {
  float* data;
  int y, x, rows, columns;
  __device__ __forceinline__ int size() const { return rows * columns; }
  __device__ __forceinline__ float const* at(int row, int column) const {
    return data + (row - y) * columns + (column - x);
  }
};

// Fills the first C planes with the channels of an image, times `scale`: the tile's columns, and `reach` columns on
// either side. Each thread issues many loads before it uses the first.
template <int C, class T>
__device__ __forceinline__ void load_planes(SharedPlanes const& s, Images<T const> const& image, int64_t b,
                                            Border border, int reach, float scale) {
  constexpr int kStep = kThreads / kColumns, kBatch = 9;
  auto const fetch = [&](int row, int x, float(&v)[C]) {
    int const y = pixel_at(border, s.y + row, int(image.height));
    T const* const from = image.row(b, 0, y) + x * image.step;
#pragma unroll
    for (int c = 0; c < C; ++c) v[c] = y < 0 || x < 0 ? 0.f : read(from[c * image.channel_stride]);
  };
  auto const put = [&](int row, int column, float const(&v)[C]) {
#pragma unroll
    for (int c = 0; c < C; ++c) s.data[c * s.size() + row * s.columns + column] = v[c] * scale;
  };
  int const column_of_thread = reach + threadIdx.x % kColumns,
            x = pixel_at(border, s.x + column_of_thread, int(image.width));
  for (int first = threadIdx.x / kColumns; first < s.rows; first += kBatch * kStep) {
    float v[kBatch][C];
#pragma unroll
    for (int i = 0; i < kBatch; ++i)
      if (first + i * kStep < s.rows) fetch(first + i * kStep, x, v[i]);
#pragma unroll
    for (int i = 0; i < kBatch; ++i)
      if (first + i * kStep < s.rows) put(first + i * kStep, column_of_thread, v[i]);
  }
  for (int i = threadIdx.x; i < s.rows * 2 * reach; i += kThreads) {
    int const row = unsigned(i) / unsigned(2 * reach), k = i - row * 2 * reach;
    int const column = k < reach ? k : kColumns + k;
    float v[C];
    fetch(row, pixel_at(border, s.x + column, int(image.width)), v);
    put(row, column, v);
  }
}

// The logarithm of a weight, from its spatial part and two pixels that are scaled to unit falloff in color.
template <int C, bool L1>
__device__ __forceinline__ float log_weight(float space, float const (&p)[C], float const (&q)[C]) {
  if constexpr (L1) {
    float sum = fabsf(p[0] - q[0]);
#pragma unroll
    for (int c = 1; c < C; ++c) sum += fabsf(p[c] - q[c]);
    return space - sum * sum;
  } else {
#pragma unroll
    for (int c = 0; c < C; ++c) space -= (p[c] - q[c]) * (p[c] - q[c]);
    return space;
  }
}

// The weighted sums of C channels, and the sums of the weights, for the run of pixels that begins at (y, x). With R > 0
// the window has 2 R + 1 rows and columns at compile time, and the weight 1 of its center is not computed.
template <int C, bool L1, int R, int Run>
__device__ __forceinline__ void sum_run(SharedPlanes const& s, int ry, [[maybe_unused]] int rx,
                                        Falloff<float> const& falloff, int y, int x, float (&sum)[Run][C],
                                        float (&total)[Run]) {
  float center[Run][C];
#pragma unroll
  for (int i = 0; i < Run; ++i) {
    total[i] = 0;
#pragma unroll
    for (int c = 0; c < C; ++c) {
      sum[i][c] = 0;
      center[i][c] = s.at(y + i, x)[c * s.size()];
    }
  }
  auto const column = [&](int dx, auto is_center) {
    float const space_x = falloff.space_x * float(dx * dx);
    auto const pixel_row = [&](int row) {  // adds a row to the pixels of the run that have it in their windows
      float pixel[C];
#pragma unroll
      for (int c = 0; c < C; ++c) pixel[c] = s.at(y + row, x + dx)[c * s.size()];
#pragma unroll
      for (int i = 0; i < Run; ++i) {
        int const dy = row - i;
        if (dy < -(R > 0 ? R : ry) || dy > (R > 0 ? R : ry)) continue;
        float weight = 1;
        if (!is_center || dy != 0)
          weight = fast_exp2(log_weight<C, L1>(falloff.space_y * float(dy * dy) + space_x, pixel, center[i]));
        total[i] += weight;
#pragma unroll
        for (int c = 0; c < C; ++c) sum[i][c] += weight * pixel[c];
      }
    };
    if constexpr (R > 0) {
#pragma unroll
      for (int row = -R; row < Run + R; ++row) pixel_row(row);
    } else {
      for (int row = -ry; row < Run + ry; ++row) pixel_row(row);
    }
  };
  // One code for all columns but the center's: that of each of them would not fit into the cache of instructions.
  if constexpr (R > 0) {
    column(0, std::true_type{});
#pragma unroll 1
    for (int dx = 1; dx <= R; ++dx) {
#pragma unroll 1
      for (int side = -1; side <= 1; side += 2) column(side * dx, std::false_type{});
    }
  } else {
    for (int dx = -rx; dx <= rx; ++dx) column(dx, std::false_type{});
  }
}

// --- plain kernels ---------------------------------------------------------------------------------------------------

// A pixel's first channel, or null for the constant 0.
template <class T>
__device__ __forceinline__ T* pixel(Images<T> const& image, int64_t b, Border border, int y, int x) {
  y = pixel_at(border, y, int(image.height));
  x = pixel_at(border, x, int(image.width));
  return y < 0 || x < 0 ? nullptr : image.row(b, 0, y) + x * image.step;
}

template <class T>
__device__ __forceinline__ auto value(Images<T> const& image, T* pixel, int c) {
  using F = Compute<std::remove_const_t<T>>;
  return pixel ? read(pixel[c * image.channel_stride]) : F(0);
}

// The distance of two pixels of the guide: the sum of absolute or squared differences.
template <class T>
__device__ __forceinline__ auto distance(Images<T> const& guide, bool l1, T* p, T* q) {
  auto sum = value(guide, p, 0);
  sum = 0;
  for (int c = 0; c < guide.channels; ++c) {
    auto const difference = value(guide, p, c) - value(guide, q, c);
    sum += l1 ? fabs(difference) : difference * difference;
  }
  return sum;
}

// The guide of a call: x, or the second image of a joint blur.
template <bool Joint, class Params>
__device__ __forceinline__ auto const& guide_of(Params const& p) {
  if constexpr (Joint)
    return p.guide;
  else
    return p.x;
}

// Channels that a thread of a plain kernel sums at a time.
constexpr int kChunk = 4;

// As sum_run, for a chunk of channels from c on and one pixel (y, x).
template <bool Joint, class Params, class F>
__device__ __forceinline__ F sum_window(Params const& p, Falloff<F> const& falloff, int64_t b, int c, int y, int x,
                                        F (&sum)[kChunk]) {
  auto const& guide = guide_of<Joint>(p);
  int const ry = p.ky / 2, rx = p.kx / 2;
  auto const* const center = pixel(guide, b, p.border, y, x);
  F total = 0;
  for (int k = 0; k < kChunk; ++k) sum[k] = 0;
  for (int dy = -ry; dy <= ry; ++dy)
    for (int dx = -rx; dx <= rx; ++dx) {
      F const d = distance(guide, p.l1, pixel(guide, b, p.border, y + dy, x + dx), center);
      F const space = falloff.space_y * F(dy * dy) + falloff.space_x * F(dx * dx);
      F const weight = fast_exp2(space - (p.l1 ? d * d : d) * falloff.color);
      total += weight;
      auto const* const from = pixel(p.x, b, p.border, y + dy, x + dx);
#pragma unroll
      for (int k = 0; k < kChunk; ++k)
        if (c + k < p.x.channels) sum[k] += weight * value(p.x, from, c + k);
    }
  return total;
}

}  // namespace
}  // namespace kv::filters::cuda
