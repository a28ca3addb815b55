// Demosaicing on CUDA: a thread takes four adjacent pixels and reads their neighborhood through the caches, where the
// rows of a block of 128 x 8 pixels overlap. Three quarters of the memory traffic are the result.
#include "raw.h"
#include "vectors.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kPixelsPerThread = 4, kRows = 8;

// Pixels x - 1 ... x + 4 of a row; `left` and `right` are the indices of the outer two.
template <class T, bool Vectorized>
__device__ __forceinline__ void load_row(T const* row, int x, int left, int right, int width,
                                         Compute<T> (&v)[kPixelsPerThread + 2]) {
  v[0] = read(row[left]);
  if constexpr (Vectorized) {
    auto const vector = *reinterpret_cast<Vector<T, kPixelsPerThread> const*>(row + x);
#pragma unroll
    for (int j = 0; j < kPixelsPerThread; ++j) v[1 + j] = read(vector.v[j]);
  } else {
#pragma unroll
    for (int j = 0; j < kPixelsPerThread; ++j) v[1 + j] = read(row[min(x + j, width - 1)]);
  }
  v[kPixelsPerThread + 1] = read(row[right]);
}

template <class T, bool Vectorized>
__device__ __forceinline__ void store_pixels(T* row, int x, int width, Compute<T> const (&v)[kPixelsPerThread]) {
  if constexpr (Vectorized) {
    store_vector(row + x, v);
  } else {
#pragma unroll
    for (int j = 0; j < kPixelsPerThread; ++j)
      if (x + j < width) row[x + j] = round_to<T>(v[j]);
  }
}

// The first pixel of a thread, its row and its image.
struct ThreadPosition {
  int x, y;
  int64_t image;
  __device__ __forceinline__ ThreadPosition()
      : x(int(blockIdx.x * 32 + threadIdx.x) * kPixelsPerThread),
        y(int(blockIdx.y * kRows + threadIdx.y)),
        image(blockIdx.z) {}
};

template <class T, bool Vectorized>
__global__ void __launch_bounds__(32 * kRows) run(__grid_constant__ RawToRgb<T> const p, int64_t images) {
  using F = Compute<T>;
  ThreadPosition at;
  int const width = int(p.raw.width), height = int(p.raw.height);
  if (at.x >= width || at.y >= height) return;
  // In a row that ends within the thread's pixels, the pixel after the last one is one of them.
  int const left = int(reflected(at.x - 1, width)), right = int(reflected(min(at.x + kPixelsPerThread, width), width));
  int const row_color = p.row_color(at.y), phase = p.phase(at.y), planes[] = {row_color, 1, 2 - row_color};
  for (; at.image < images; at.image += gridDim.z) {
    F around[3][kPixelsPerThread + 2], result[3][kPixelsPerThread];
#pragma unroll
    for (int k = 0; k < 3; ++k)
      load_row<T, Vectorized>(p.raw.row(at.image, reflected(at.y + k - 1, height)), at.x, left, right, width,
                              around[k]);
    if (!Vectorized && width - at.x < kPixelsPerThread)  // two pixels then, as widths are even
#pragma unroll
      for (int k = 0; k < 3; ++k) around[k][3] = around[k][1];
#pragma unroll
    for (int j = 0; j < kPixelsPerThread; ++j) {
      F v[3][3];
#pragma unroll
      for (int k = 0; k < 9; ++k) v[k / 3][k % 3] = around[k / 3][j + k % 3];
      Demosaic<F> const d(v[0], v[1], v[2]);
#pragma unroll
      for (int k = 0; k < 3; ++k) result[k][j] = j % 2 == phase ? d.at_row_color[k] : d.at_green[k];
    }
#pragma unroll
    for (int k = 0; k < 3; ++k)
      store_pixels<T, Vectorized>(p.rgb.row(3 * at.image + planes[k], at.y), at.x, width, result[k]);
  }
}

template <class T, bool Vectorized>
__global__ void __launch_bounds__(32 * kRows)
    run_backward(__grid_constant__ RawToRgbBackward<T> const p, int64_t images) {
  using F = Compute<T>;
  ThreadPosition at;
  int const width = int(p.grad.width), height = int(p.grad.height);
  if (at.x >= width || at.y >= height) return;
  int const left = max(at.x - 1, 0), right = min(at.x + kPixelsPerThread, width - 1);
  int const row_color = p.forward.row_color(at.y), phase = p.forward.phase(at.y);
  F const up = F(reader_count(at.y - 1, height)), down = F(reader_count(at.y + 1, height));
  for (; at.image < images; at.image += gridDim.z) {
    F grad_row_color[3][kPixelsPerThread + 2], grad_green[3][kPixelsPerThread + 2], result[kPixelsPerThread];
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      int const y = clamp(at.y + k - 1, 0, height - 1);
      load_row<T, Vectorized>(p.grad.row(3 * at.image + row_color, y), at.x, left, right, width, grad_row_color[k]);
      load_row<T, Vectorized>(p.grad.row(3 * at.image + 1, y), at.x, left, right, width, grad_green[k]);
    }
#pragma unroll
    for (int j = 0; j < kPixelsPerThread; ++j) {
      bool const has_row_color = j % 2 == phase;
      F v[3][3];
#pragma unroll
      for (int k = 0; k < 9; ++k)
        v[k / 3][k % 3] = has_row_color ? grad_row_color[k / 3][j + k % 3] : grad_green[k / 3][j + k % 3];
      result[j] = demosaic_vjp(has_row_color, v[0], v[1], v[2], up, down, F(reader_count(at.x + j - 1, width)),
                               F(reader_count(at.x + j + 1, width)));
    }
    store_pixels<T, Vectorized>(p.grad_raw.row(at.image, at.y), at.x, width, result);
  }
}

}  // namespace

template <class T>
int raw_to_rgb(RawToRgb<T> const& p, CUstream_st* stream) {
  int64_t const images = p.raw.count();
  dim3 const blocks = blocks_of_vectors<kPixelsPerThread>(p.raw.width, p.raw.height, kRows, images), threads(32, kRows);
  if (has_whole_vectors<kPixelsPerThread>(p.raw) && has_whole_vectors<kPixelsPerThread>(p.rgb))
    run<T, true><<<blocks, threads, 0, stream>>>(p, images);
  else
    run<T, false><<<blocks, threads, 0, stream>>>(p, images);
  return cudaGetLastError();
}

template <class T>
int raw_to_rgb_backward(RawToRgbBackward<T> const& p, CUstream_st* stream) {
  int64_t const images = p.grad_raw.count();
  dim3 const blocks = blocks_of_vectors<kPixelsPerThread>(p.grad.width, p.grad.height, kRows, images),
             threads(32, kRows);
  if (has_whole_vectors<kPixelsPerThread>(p.grad) && has_whole_vectors<kPixelsPerThread>(p.grad_raw))
    run_backward<T, true><<<blocks, threads, 0, stream>>>(p, images);
  else
    run_backward<T, false><<<blocks, threads, 0, stream>>>(p, images);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(raw_to_rgb, RawToRgb)
KV_INSTANTIATE(raw_to_rgb_backward, RawToRgbBackward)

}  // namespace kv::color::cuda
