// Demosaicing on CUDA: a thread takes four pixels of a row and reads what is around them from the caches, where the
// rows of a block of 128 x 8 pixels meet again: three quarters of the traffic are what is written.
#include "raw.h"
#include "vectors.cuh"

namespace kv::cuda {
namespace {

constexpr int kTaken = 4, kRows = 8;

// Pixels x - 1 ... x + 4 of a row; `left` and `right` are where the outer two stand.
template <class T, bool Vectorized>
__device__ __forceinline__ void load_around(T const* row, int x, int left, int right, int width,
                                            Compute<T> (&v)[kTaken + 2]) {
  v[0] = read(row[left]);
  if constexpr (Vectorized) {
    auto const vector = *reinterpret_cast<Vector<T, kTaken> const*>(row + x);
#pragma unroll
    for (int j = 0; j < kTaken; ++j) v[1 + j] = read(vector.v[j]);
  } else {
#pragma unroll
    for (int j = 0; j < kTaken; ++j) v[1 + j] = read(row[min(x + j, width - 1)]);
  }
  v[kTaken + 1] = read(row[right]);
}

template <class T, bool Vectorized>
__device__ __forceinline__ void store_taken(T* row, int x, int width, Compute<T> const (&v)[kTaken]) {
  if constexpr (Vectorized) {
    store_vector(row + x, v);
  } else {
#pragma unroll
    for (int j = 0; j < kTaken; ++j)
      if (x + j < width) row[x + j] = round_to<T>(v[j]);
  }
}

// The place of a thread: its first pixel, its row, its image.
struct Place {
  int x, y;
  int64_t image;
  __device__ __forceinline__ Place()
      : x(int(blockIdx.x * 32 + threadIdx.x) * kTaken), y(int(blockIdx.y * kRows + threadIdx.y)), image(blockIdx.z) {}
};

template <class T, bool Vectorized>
__global__ void __launch_bounds__(32 * kRows) run(__grid_constant__ RawToRgb<T> const p, int64_t images) {
  using F = Compute<T>;
  Place at;
  int const width = int(p.raw.width), height = int(p.raw.height);
  if (at.x >= width || at.y >= height) return;
  // Of a row that ends inside the pixels taken, the pixel after its last one is within them.
  int const left = int(mirrored(at.x - 1, width)), right = int(mirrored(min(at.x + kTaken, width), width));
  int const own = p.own(at.y), phase = p.phase(at.y), planes[] = {own, 1, 2 - own};
  for (; at.image < images; at.image += gridDim.z) {
    F around[3][kTaken + 2], result[3][kTaken];
#pragma unroll
    for (int k = 0; k < 3; ++k)
      load_around<T, Vectorized>(p.raw.row(at.image, mirrored(at.y + k - 1, height)), at.x, left, right, width,
                                 around[k]);
    if (!Vectorized && width - at.x < kTaken)  // two pixels then, as widths are even
#pragma unroll
      for (int k = 0; k < 3; ++k) around[k][3] = around[k][1];
#pragma unroll
    for (int j = 0; j < kTaken; ++j) {
      F v[3][3];
#pragma unroll
      for (int k = 0; k < 9; ++k) v[k / 3][k % 3] = around[k / 3][j + k % 3];
      Demosaiced<F> const d(v[0], v[1], v[2]);
#pragma unroll
      for (int k = 0; k < 3; ++k) result[k][j] = j % 2 == phase ? d.at_own[k] : d.at_green[k];
    }
#pragma unroll
    for (int k = 0; k < 3; ++k)
      store_taken<T, Vectorized>(p.rgb.row(3 * at.image + planes[k], at.y), at.x, width, result[k]);
  }
}

template <class T, bool Vectorized>
__global__ void __launch_bounds__(32 * kRows)
    run_backward(__grid_constant__ RawToRgbBackward<T> const p, int64_t images) {
  using F = Compute<T>;
  Place at;
  int const width = int(p.grad.width), height = int(p.grad.height);
  if (at.x >= width || at.y >= height) return;
  int const left = max(at.x - 1, 0), right = min(at.x + kTaken, width - 1);
  int const own = p.forward.own(at.y), phase = p.forward.phase(at.y);
  F const up = F(times(at.y - 1, height)), down = F(times(at.y + 1, height));
  for (; at.image < images; at.image += gridDim.z) {
    F of_own[3][kTaken + 2], of_green[3][kTaken + 2], result[kTaken];
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      int const y = clamp(at.y + k - 1, 0, height - 1);
      load_around<T, Vectorized>(p.grad.row(3 * at.image + own, y), at.x, left, right, width, of_own[k]);
      load_around<T, Vectorized>(p.grad.row(3 * at.image + 1, y), at.x, left, right, width, of_green[k]);
    }
#pragma unroll
    for (int j = 0; j < kTaken; ++j) {
      bool const is_own = j % 2 == phase;
      F v[3][3];
#pragma unroll
      for (int k = 0; k < 9; ++k) v[k / 3][k % 3] = is_own ? of_own[k / 3][j + k % 3] : of_green[k / 3][j + k % 3];
      result[j] =
          gathered(is_own, v[0], v[1], v[2], up, down, F(times(at.x + j - 1, width)), F(times(at.x + j + 1, width)));
    }
    store_taken<T, Vectorized>(p.grad_raw.row(at.image, at.y), at.x, width, result);
  }
}

}  // namespace

template <class T>
int raw_to_rgb(RawToRgb<T> const& p, CUstream_st* stream) {
  int64_t const images = p.raw.count();
  dim3 const blocks = blocks_of_vectors<kTaken>(p.raw.width, p.raw.height, kRows, images), threads(32, kRows);
  if (has_whole_vectors<kTaken>(p.raw) && has_whole_vectors<kTaken>(p.rgb))
    run<T, true><<<blocks, threads, 0, stream>>>(p, images);
  else
    run<T, false><<<blocks, threads, 0, stream>>>(p, images);
  return cudaGetLastError();
}

template <class T>
int raw_to_rgb_backward(RawToRgbBackward<T> const& p, CUstream_st* stream) {
  int64_t const images = p.grad_raw.count();
  dim3 const blocks = blocks_of_vectors<kTaken>(p.grad.width, p.grad.height, kRows, images), threads(32, kRows);
  if (has_whole_vectors<kTaken>(p.grad) && has_whole_vectors<kTaken>(p.grad_raw))
    run_backward<T, true><<<blocks, threads, 0, stream>>>(p, images);
  else
    run_backward<T, false><<<blocks, threads, 0, stream>>>(p, images);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(raw_to_rgb, RawToRgb)
KV_INSTANTIATE(raw_to_rgb_backward, RawToRgbBackward)

}  // namespace kv::cuda
