// Backward pass of the median blur on CUDA: one launch for every window and layout. A block takes a tile of pixels of
// one channel. The outputs around the tile go through shared memory, chunk by chunk, each with its median and the
// gradient of one tied pixel, g / (pixels of the window that equal the median). A pixel sums the gradients of the
// windows whose median it equals.
#include "core/launch.cuh"
#include "median.h"

namespace kv::filters::cuda {
namespace {

constexpr int kTile = 32, kRowsOfThreads = 8, kPixelsDown = kTile / kRowsOfThreads;
constexpr int kChunkWidth = 64, kChunkHeight = 40;  // with 5x5 windows one chunk holds a tile and all outputs around it

template <class F>
struct TiedGradient {
  F median, gradient;
};

// K: the size of a square window known at compile time, or 0.
template <int K, class T>
__global__ void __launch_bounds__(kTile* kRowsOfThreads)
    median_backward_tile(MedianBlurBackward<T> p, unsigned across, unsigned down) {
  using F = Compute<T>;
  __shared__ TiedGradient<F> chunk[kChunkHeight][kChunkWidth];

  unsigned const tile = blockIdx.x / across;
  int64_t const channel_plane = tile / down, plane = channel_plane / p.x.step, channel = channel_plane % p.x.step;
  int const x0 = int(blockIdx.x - tile * across) * kTile, y0 = int(tile - unsigned(channel_plane) * down) * kTile;
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

}  // namespace

template <class T>
int median_blur_backward(MedianBlurBackward<T> const& p, CUstream_st* stream) {
  int64_t const across = ceil_div(p.x.width, kTile), down = ceil_div(p.x.height, kTile);
  unsigned const blocks = unsigned(p.x.count() * p.x.step * across * down);
  dim3 const threads(kTile, kRowsOfThreads);
  if (p.ky == 3 && p.kx == 3)
    median_backward_tile<3><<<blocks, threads, 0, stream>>>(p, across, down);
  else if (p.ky == 5 && p.kx == 5)
    median_backward_tile<5><<<blocks, threads, 0, stream>>>(p, across, down);
  else
    median_backward_tile<0><<<blocks, threads, 0, stream>>>(p, across, down);
  return cudaGetLastError();
}

KV_INSTANTIATE(median_blur_backward, MedianBlurBackward)

}  // namespace kv::filters::cuda
