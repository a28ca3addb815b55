// Sums of moved copies on CUDA: a thread has pixels of a row, a warp's width apart, in up to three channels.
#include "augmentation/corruption/moved.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kMovedRows = 8, kMovedPixels = 2;  // rows of a block, a warp each, and pixels of a thread

template <class T, int Channels>
__global__ void __launch_bounds__(32 * kMovedRows) sum_moved(__grid_constant__ SumOfMoved<T> const p) {
  using F = Compute<T>;
  int64_t const groups = p.channels / Channels, b = blockIdx.z / groups, c = blockIdx.z % groups * Channels;
  int const y = blockIdx.y * kMovedRows + threadIdx.y, left = blockIdx.x * 32 * kMovedPixels + threadIdx.x;
  if (y >= p.height) return;
  T const* const x = p.x + b * p.x_strides[0] + c * p.x_strides[1];
  F sum[kMovedPixels][Channels] = {};
  for (int64_t k = 0; k < p.num_moves; ++k) {
    F const* const move = p.moves + b * p.move_stride + 4 * k;
    F const scale = move[0], weight = move[3];
    if (weight == 0) continue;
    PairOfTaps<F> const down(scale * F(y) + move[2], int(p.height));
    T const *const upper = x + down.first * p.x_strides[2], *const lower = x + down.second * p.x_strides[2];
#pragma unroll
    for (int i = 0; i < kMovedPixels; ++i) {
      PairOfTaps<F> const across(scale * F(left + 32 * i) + move[1], int(p.width));
      int64_t const first = across.first * p.x_strides[3], second = across.second * p.x_strides[3];
#pragma unroll
      for (int j = 0; j < Channels; ++j) {
        int64_t const channel = j * p.x_strides[1];
        F value = read(upper[channel + first]);
        if (across.t > 0) value += across.t * (read(upper[channel + second]) - value);
        if (down.t > 0) {
          F other = read(lower[channel + first]);
          if (across.t > 0) other += across.t * (read(lower[channel + second]) - other);
          value += down.t * (other - value);
        }
        sum[i][j] += weight * value;
      }
    }
  }
  T* const result = p.y + b * p.y_strides[0] + c * p.y_strides[1] + y * p.y_strides[2];
#pragma unroll
  for (int i = 0; i < kMovedPixels; ++i)
    if (left + 32 * i < p.width)
#pragma unroll
      for (int j = 0; j < Channels; ++j)
        result[(left + 32 * i) * p.y_strides[3] + j * p.y_strides[1]] = round_to<T>(sum[i][j]);
}

template <class T, int Channels>
int launch(SumOfMoved<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.width, 32 * kMovedPixels)), unsigned(ceil_div(p.height, kMovedRows)),
                    unsigned(p.batch * p.channels / Channels));
  sum_moved<T, Channels><<<blocks, dim3(32, kMovedRows), 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int sum_of_moved(SumOfMoved<T> const& p, CUstream_st* stream) {
  return p.channels == 3 ? launch<T, 3>(p, stream) : launch<T, 1>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(sum_of_moved, SumOfMoved)

}  // namespace kv::augmentation::cuda
