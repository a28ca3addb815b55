// Backward pass of the median blur on CUDA: one launch for every window and layout. A block takes a tile of pixels of
// one channel. The outputs around the tile go through shared memory, each with its median and the gradient of one tied
// pixel, g / (pixels of the window that equal the median). A pixel sums the gradients of the windows whose median it
// equals.
#include "core/launch.cuh"
#include "core/stencils/gradient_list.cuh"
#include "median.h"

namespace kv::filters::cuda {
namespace {

constexpr int kTile = 32, kRowsOfThreads = 8, kPixelsDown = kTile / kRowsOfThreads;
constexpr int kChunkWidth = 64, kChunkHeight = 40;  // with 5x5 windows one chunk holds a tile and all outputs around it

template <class F>
struct TiedGradient {
  F median, gradient;
};

// The parts of planes that blocks have.
struct Parts {
  unsigned across, down;
  KV_HD Parts(int64_t width, int64_t height, int each_across, int each_down)
      : across(unsigned(ceil_div(width, int64_t(each_across)))), down(unsigned(ceil_div(height, int64_t(each_down)))) {}
};

// K: the size of a square window known at compile time, or 0.
template <int K, class T>
__device__ __forceinline__ void gradients_of_tile(MedianBlurBackward<T> const& p, Parts const& parts, unsigned block) {
  using F = Compute<T>;
  __shared__ TiedGradient<F> chunk[kChunkHeight][kChunkWidth];

  unsigned const tile = block / parts.across;
  int64_t const channel_plane = tile / parts.down, plane = channel_plane / p.x.step, channel = channel_plane % p.x.step;
  int const x0 = int(block - tile * parts.across) * kTile,
            y0 = int(tile - unsigned(channel_plane) * parts.down) * kTile;
  int const step = int(p.x.step), width = int(p.x.width), height = int(p.x.height);
  int const ky = K ? K : int(p.ky), kx = K ? K : int(p.kx), ry = ky / 2, rx = kx / 2;
  int const before_y = (ky - 1) / 2, before_x = (kx - 1) / 2;
  T const* const in = p.x.plane(plane) + channel;
  bool const circular = p.border == Border::circular;

  auto const tied_gradient = [&](int qy, int qx) -> TiedGradient<F> {
    if (circular) {
      qy += qy < 0 ? height : qy >= height ? -height : 0;
      qx += qx < 0 ? width : qx >= width ? -width : 0;
    }
    if (qy < 0 || qy >= height || qx < 0 || qx >= width) return {F(__builtin_nan("")), F(0)};
    int const top = qy - before_y, left = qx - before_x;
    int64_t const e = int64_t(qx) * step + channel;
    F const median = read(p.y.row(plane, qy)[e]);
    int equal = 0;
    if (top >= 0 && left >= 0 && top + ky <= height && left + kx <= width) {
      T const* row = in + top * p.x.row_stride + int64_t(left) * step;
#pragma unroll
      for (int dy = 0; dy < ky; ++dy, row += p.x.row_stride)
#pragma unroll
        for (int dx = 0; dx < kx; ++dx) equal += read(row[int64_t(dx) * step]) == median;
    } else {
      for (int dy = 0; dy < ky; ++dy) {
        int const yy = border_index(p.border, top + dy, height);
        for (int dx = 0; dx < kx; ++dx) {
          int const xx = border_index(p.border, left + dx, width);
          equal += (yy < 0 || xx < 0 ? F(0) : read(in[yy * p.x.row_stride + int64_t(xx) * step])) == median;
        }
      }
    }
    return {median, read(p.grad.row(plane, qy)[e]) / F(equal)};
  };

  int const x = x0 + threadIdx.x;
  F value[kPixelsDown], sum[kPixelsDown];
#pragma unroll
  for (int i = 0; i < kPixelsDown; ++i) {
    int const y = y0 + threadIdx.y + i * kRowsOfThreads;
    sum[i] = 0;
    value[i] = x < width && y < height ? read(in[y * p.x.row_stride + int64_t(x) * step]) : F(0);
  }

  int const y_end = min(y0 + kTile, height) + ry, x_end = min(x0 + kTile, width) + rx;
  for (int cy = y0 - ry; cy < y_end; cy += kChunkHeight)
    for (int cx = x0 - rx; cx < x_end; cx += kChunkWidth) {
      int const rows = min(kChunkHeight, y_end - cy), columns = min(kChunkWidth, x_end - cx);
      for (int i = threadIdx.y; i < rows; i += kRowsOfThreads)
        for (int k = threadIdx.x; k < columns; k += kTile) chunk[i][k] = tied_gradient(cy + i, cx + k);
      __syncthreads();
#pragma unroll
      for (int i = 0; i < kPixelsDown; ++i) {
        int const y = y0 + threadIdx.y + i * kRowsOfThreads;
        if (x >= width || y >= height) continue;
        bool const near_border = x <= rx || y <= ry || x >= width - 1 - rx || y >= height - 1 - ry;
        auto const add = [&](int qy, int qx, F times) {
          TiedGradient<F> const s = chunk[qy - cy][qx - cx];
          sum[i] += s.median == value[i] ? s.gradient * times : F(0);
        };
        if (K && !near_border) {
#pragma unroll
          for (int dy = -ry; dy <= ry; ++dy)
#pragma unroll
            for (int dx = -rx; dx <= rx; ++dx) add(y + dy, x + dx, F(1));
          continue;
        }
        int const last_y = min(y + ry, cy + rows - 1), last_x = min(x + rx, cx + columns - 1);
        for (int qy = max(y - ry, cy); qy <= last_y; ++qy) {
          int const reads_y = median_read_count(p.border, qy, y, height, before_y, ry);
          for (int qx = max(x - rx, cx); qx <= last_x; ++qx)
            add(qy, qx, F(reads_y * median_read_count(p.border, qx, x, width, before_x, rx)));
        }
      }
      __syncthreads();
    }

#pragma unroll
  for (int i = 0; i < kPixelsDown; ++i) {
    int const y = y0 + threadIdx.y + i * kRowsOfThreads;
    if (x < width && y < height) p.grad_x.row(plane, y)[int64_t(x) * step + channel] = round_to<T>(sum[i]);
  }
}

template <class T>
KV_HD Parts tiles_of(MedianBlurBackward<T> const& p) {
  return {p.x.width, p.x.height, kTile, kTile};
}
template <int K, class T>
__global__ void __launch_bounds__(kTile* kRowsOfThreads)
    median_backward_tile(__grid_constant__ MedianBlurBackward<T> const p, Parts const parts) {
  gradients_of_tile<K>(p, parts, blockIdx.x);
}

// --- planar images and windows of 3 x 3 or 5 x 5 pixels ------------------------------------------------------------------

// A thread has a column of the tile: several outputs at once for the counts, then several pixels at once for the sums.
// So it reads a number from shared memory once for all windows along y that contain it.
constexpr int kColumns = 96, kGroups = 4, kThreads = kColumns * kGroups;  // kGroups: of rows
constexpr int kOutputsDown = 9, kPixelsOfColumn = 8;

template <int K>
struct StripTile {
  static constexpr int R = K / 2, kWidth = kColumns - 2 * R, kHeight = kGroups * kPixelsOfColumn;  // pixels
  static constexpr int kOutputs = kGroups * kOutputsDown;                                          // rows of outputs
  static_assert(kOutputs >= kHeight + 2 * R);
  float pixels[kOutputs + 2 * R][kColumns + 2 * R];
  TiedGradient<float> outputs[kOutputs][kColumns];
  int sources[kOutputs + 2 * R];  // the image's rows of pixels, or -1
  float counts[kHeight][K];       // how often the outputs around a row of pixels read it
};

template <int K, class T>
__device__ __forceinline__ void gradients_of_columns(MedianBlurBackward<T> const& p, Parts const& parts,
                                                     unsigned block) {
  constexpr int R = K / 2;
  using Tile = StripTile<K>;
  __shared__ Tile tile;
  unsigned const line = block / parts.across, plane = line / parts.down;
  int const x0 = int(block - line * parts.across) * Tile::kWidth, y0 = int(line - plane * parts.down) * Tile::kHeight;
  int const width = int(p.x.width), height = int(p.x.height);
  int const column = threadIdx.x % kColumns, group = threadIdx.x / kColumns;
  bool const circular = p.border == Border::circular;
  bool const at_border = x0 <= R || y0 <= R || x0 + Tile::kWidth >= width - R || y0 + Tile::kHeight >= height - R;

  for (int row = threadIdx.x; row < Tile::kOutputs + 2 * R; row += kThreads)
    tile.sources[row] = border_index(p.border, y0 - 2 * R + row, height);
  if (at_border)
    for (int i = threadIdx.x; i < Tile::kHeight * K; i += kThreads) {
      int const y = y0 + i / K;
      tile.counts[i / K][i % K] = y < height ? float(median_read_count(p.border, y - R + i % K, y, height, R, R)) : 0.f;
    }
  int const first = x0 - 2 * R + column;  // the position of the thread's pixel in a row of the tile
  int const source = border_index(p.border, first, width), second = border_index(p.border, first + kColumns, width);

  float medians[kOutputsDown];
  int const x = first + R, output_x = circular ? border_index(Border::circular, x, width) : x;
  bool const column_exists = unsigned(output_x) < unsigned(width);
  T const *const medians_of = p.y.plane(plane) + output_x, *const gradients_of = p.grad.plane(plane) + output_x;
#pragma unroll
  for (int q = 0; q < kOutputsDown; ++q) {
    int const row = y0 - R + group * kOutputsDown + q;
    int const y = circular ? border_index(Border::circular, row, height) : row;
    bool const exists = column_exists && unsigned(y) < unsigned(height);
    medians[q] = exists ? read(medians_of[y * p.y.row_stride]) : __int_as_float(0x7fc00000);
    float const gradient = exists ? read(gradients_of[y * p.grad.row_stride]) : 0.f;
    tile.outputs[group * kOutputsDown + q][column] = {medians[q], gradient};
  }
  __syncthreads();
  T const* const in = p.x.plane(plane);
#pragma unroll 5
  for (int row = group; row < Tile::kOutputs + 2 * R; row += kGroups) {
    int const y = tile.sources[row];
    T const* const from = in + max(y, 0) * p.x.row_stride;
    tile.pixels[row][column] = y >= 0 && source >= 0 ? read(from[source]) : 0.f;
    if (column < 2 * R) tile.pixels[row][kColumns + column] = y >= 0 && second >= 0 ? read(from[second]) : 0.f;
  }
  __syncthreads();
  float equal[kOutputsDown] = {};
#pragma unroll
  for (int r = 0; r < kOutputsDown + 2 * R; ++r)
#pragma unroll
    for (int c = 0; c < K; ++c) {
      float const pixel = tile.pixels[group * kOutputsDown + r][column + c];
#pragma unroll
      for (int q = max(0, r - 2 * R); q <= min(r, kOutputsDown - 1); ++q)
        if (pixel == medians[q]) equal[q] += 1;
    }
#pragma unroll
  for (int q = 0; q < kOutputsDown; ++q)
    if (equal[q] != 1) tile.outputs[group * kOutputsDown + q][column].gradient /= equal[q];
  __syncthreads();

  if (column < R || column >= kColumns - R || x >= width) return;
  float value[kPixelsOfColumn], sum[kPixelsOfColumn] = {};
#pragma unroll
  for (int i = 0; i < kPixelsOfColumn; ++i) value[i] = tile.pixels[group * kPixelsOfColumn + 2 * R + i][column + R];
  auto const add_all = [&](auto weight_x, auto weight_y) {
#pragma unroll
    for (int r = 0; r < kPixelsOfColumn + 2 * R; ++r)
#pragma unroll
      for (int c = 0; c < K; ++c) {
        TiedGradient<float> const output = tile.outputs[group * kPixelsOfColumn + r][column - R + c];
        float const gradient = weight_x(c, output.gradient);
#pragma unroll
        for (int i = max(0, r - 2 * R); i <= min(r, kPixelsOfColumn - 1); ++i)
          if (output.median == value[i]) sum[i] += weight_y(i, r - i, gradient);
      }
  };
  if (at_border) {
    float counts[K];
#pragma unroll
    for (int c = 0; c < K; ++c) counts[c] = float(median_read_count(p.border, x - R + c, x, width, R, R));
    add_all([&](int c, float g) { return g * counts[c]; },
            [&](int i, int k, float g) { return g * tile.counts[group * kPixelsOfColumn + i][k]; });
  } else {
    add_all([](int, float g) { return g; }, [](int, int, float g) { return g; });
  }
  int const y = y0 + group * kPixelsOfColumn;
  T* const out = p.grad_x.plane(plane) + x;
#pragma unroll
  for (int i = 0; i < kPixelsOfColumn; ++i)
    if (y + i < height) out[(y + i) * p.grad_x.row_stride] = round_to<T>(sum[i]);
}

template <int K, class T>
KV_HD Parts columns_of(MedianBlurBackward<T> const& p) {
  return {p.x.width, p.x.height, StripTile<K>::kWidth, StripTile<K>::kHeight};
}
// Whether the columns of a tile wrap at most once around an image with the circular border.
template <int K, class T>
bool fit_columns(MedianBlurBackward<T> const& p) {
  return p.ky == K && p.kx == K && p.x.step == 1 &&
         (p.border != Border::circular || min(p.x.width, p.x.height) >= 2 * K);
}

// Five blocks on a multiprocessor, of 32 registers: 1.14 times as fast as three of 56.
template <int K, class T>
__global__ void __launch_bounds__(kThreads, 5)
    median_backward_columns(__grid_constant__ MedianBlurBackward<T> const p, Parts const parts) {
  gradients_of_columns<K>(p, parts, blockIdx.x);
}

// Special case, H200: 2.7 (3 x 3) to 4.2 (5 x 5) times as fast as tiles.
template <int K, class T>
bool try_columns(MedianBlurBackward<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    if (!fit_columns<K>(p)) return false;
    Parts const parts = columns_of<K>(p);
    unsigned const blocks = unsigned(p.x.count()) * parts.across * parts.down;
    median_backward_columns<K><<<blocks, kThreads, 0, stream>>>(p, parts);
    return true;
  }
  return false;
}

// --- lists -----------------------------------------------------------------------------------------------------------

template <int K, class T>
__global__ void __launch_bounds__(kTile* kRowsOfThreads)
    median_backward_tile_of_list(__grid_constant__ MedianBlurBackwardList<T> const list) {
  unsigned block;
  MedianBlurBackward<T> const* const p = sample_of_block(list, block);
  if (p) gradients_of_tile<K>(*p, tiles_of(*p), block);
}
template <int K, class T>
__global__ void __launch_bounds__(kThreads, 5)
    median_backward_columns_of_list(__grid_constant__ MedianBlurBackwardList<T> const list) {
  unsigned block;
  MedianBlurBackward<T> const* const p = sample_of_block(list, block);
  if (p) gradients_of_columns<K>(*p, columns_of<K>(*p), block);
}

template <int K, class T>
int launch_tiles(MedianBlurBackwardList<T> const& p, CUstream_st* stream) {
  return launch_gradients(
      p,
      [](MedianBlurBackward<T> const& one) {
        Parts const parts = tiles_of(one);
        return one.x.count() * one.x.step * parts.across * parts.down;
      },
      [&](MedianBlurBackwardList<T> const& list, unsigned blocks) {
        median_backward_tile_of_list<K><<<blocks, dim3(kTile, kRowsOfThreads), 0, stream>>>(list);
      });
}
// By columns that serve all images, or by tiles.
template <int K, class T>
int launch_windows(MedianBlurBackwardList<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8)
    if (all_gradients(p, fit_columns<K, T>))
      return launch_gradients(
          p,
          [](MedianBlurBackward<T> const& one) {
            Parts const parts = columns_of<K>(one);
            return one.x.count() * parts.across * parts.down;
          },
          [&](MedianBlurBackwardList<T> const& list, unsigned blocks) {
            median_backward_columns_of_list<K><<<blocks, kThreads, 0, stream>>>(list);
          });
  return launch_tiles<K>(p, stream);
}

}  // namespace

template <class T>
int median_blur_backward(MedianBlurBackward<T> const& p, CUstream_st* stream) {
  if (try_columns<3>(p, stream) || try_columns<5>(p, stream)) return cudaGetLastError();
  Parts const parts = tiles_of(p);
  unsigned const blocks = unsigned(p.x.count() * p.x.step) * parts.across * parts.down;
  dim3 const threads(kTile, kRowsOfThreads);
  // Special case, H200: 2.6 to 2.7 times as fast as windows of any size.
  if (p.ky == 3 && p.kx == 3) median_backward_tile<3><<<blocks, threads, 0, stream>>>(p, parts);
  // Special case, H200: 2.6 times as fast as windows of any size.
  else if (p.ky == 5 && p.kx == 5)
    median_backward_tile<5><<<blocks, threads, 0, stream>>>(p, parts);
  else
    median_backward_tile<0><<<blocks, threads, 0, stream>>>(p, parts);
  return cudaGetLastError();
}

template <class T>
int median_blur_list_backward(MedianBlurBackwardList<T> const& p, CUstream_st* stream) {
  int64_t const ky = p.all.ky, kx = p.all.kx;
  if (ky == 3 && kx == 3) return launch_windows<3>(p, stream);
  if (ky == 5 && kx == 5) return launch_windows<5>(p, stream);
  return launch_tiles<0>(p, stream);
}

KV_INSTANTIATE(median_blur_backward, MedianBlurBackward)
KV_INSTANTIATE(median_blur_list_backward, MedianBlurBackwardList)

}  // namespace kv::filters::cuda
