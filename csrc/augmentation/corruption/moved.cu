// Sums of moved copies on CUDA: a thread has pixels of a column, in up to three channels, for which it finds the
// columns that they read once.
#include "augmentation/corruption/moved.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kMovedWarps = 8, kMovedRows = 4;  // warps of a block, above each other, and rows of a thread

// Copies moved by whole pixels, of which one pixel is read: 31 of them 8 times as fast as by the general way.
template <class F>
__device__ __forceinline__ bool is_whole(F const* move) {
  return move[0] == 1 && move[1] == rint(move[1]) && move[2] == rint(move[2]);
}

// Adds what a move reads to the sums of a thread's pixels, from row `top` on. Offset: of elements of a sample.
template <class Offset, class T, int Channels, class F>
__device__ __forceinline__ void add_moved(SumOfMoved<T> const& p, T const* x, F const* move, int left, int top,
                                          F (&sum)[kMovedRows][Channels]) {
  int const height = int(p.height), width = int(p.width);
  Offset const channel = Offset(p.x_strides[1]), row = Offset(p.x_strides[2]), pixel = Offset(p.x_strides[3]);
  F const scale = move[0], weight = move[3];
  PairOfTaps<F> const across(scale * F(left) + move[1], width);
  Offset const first = across.first * pixel;
  if (is_whole(move)) {
    int const down = int(clamp(move[2], F(-height), F(height)));
#pragma unroll
    for (int i = 0; i < kMovedRows; ++i) {
      Offset const at = clamp(top + i + down, 0, height - 1) * row + first;
#pragma unroll
      for (int j = 0; j < Channels; ++j) sum[i][j] += weight * F(read(x[at + j * channel]));
    }
    return;
  }
  Offset const second = across.second * pixel;
#pragma unroll
  for (int i = 0; i < kMovedRows; ++i) {
    PairOfTaps<F> const down(scale * F(top + i) + move[2], height);
    auto const read_row = [&](Offset from) {
      F const u = read(x[from + first]), v = read(x[from + second]);
      return across.t > 0 ? u + across.t * (v - u) : u;
    };
#pragma unroll
    for (int j = 0; j < Channels; ++j) {
      F value = read_row(down.first * row + j * channel);
      if (down.t > 0) value += down.t * (read_row(down.second * row + j * channel) - value);
      sum[i][j] += weight * value;
    }
  }
}

// The transpose, of gradients. Pixels of zooms are read by few positions, which are looked at one by one.
template <class Offset, class T, int Channels, class F>
__device__ __forceinline__ void add_readers(SumOfMoved<T> const& p, T const* grad, F const* move, int left, int top,
                                            F (&sum)[kMovedRows][Channels]) {
  int const height = int(p.height), width = int(p.width);
  Offset const channel = Offset(p.x_strides[1]), row_stride = Offset(p.x_strides[2]), pixel = Offset(p.x_strides[3]);
  F const scale = move[0], weight = move[3];
  ReadersOfPixel<F> const across(scale, move[1], left, width);
#pragma unroll
  for (int i = 0; i < kMovedRows; ++i) {
    if (top + i >= height) break;
    ReadersOfPixel<F> const down(scale, move[2], top + i, height);
    for (int row = down.begin; row < down.end; ++row) {
      F const of_row = weight * down.weight(row);
      if (of_row == 0) continue;
      for (int x = across.begin; x < across.end; ++x) {
        F const own = across.weight(x);
        if (own == 0) continue;
        Offset const at = row * row_stride + x * pixel;
#pragma unroll
        for (int j = 0; j < Channels; ++j) sum[i][j] += of_row * own * F(read(grad[at + j * channel]));
      }
    }
  }
}

template <bool Backward, class T, int Channels, class Offset>
__device__ __forceinline__ void run_tile(SumOfMoved<T> const& p, unsigned column, unsigned row_block, unsigned group) {
  using F = Compute<T>;
  int64_t const groups = p.channels / Channels, b = group / groups, c = group % groups * Channels;
  int const height = int(p.height), width = int(p.width), left = column * 32 + threadIdx.x,
            top = (row_block * kMovedWarps + threadIdx.y) * kMovedRows;
  if (top >= height || left >= width) return;
  T const* const x = p.x + b * p.x_strides[0] + c * p.x_strides[1];
  F sum[kMovedRows][Channels] = {};
  for (int k = 0; k < int(p.num_moves); ++k) {
    F const* const move = p.moves + b * p.move_stride + 4 * k;
    if (move[3] == 0) continue;  // its weight
    if constexpr (Backward)
      add_readers<Offset>(p, x, move, left, top, sum);
    else
      add_moved<Offset>(p, x, move, left, top, sum);
  }
  T* const result = p.y + b * p.y_strides[0] + c * p.y_strides[1] + left * p.y_strides[3];
#pragma unroll
  for (int i = 0; i < kMovedRows; ++i)
    if (top + i < height)
#pragma unroll
      for (int j = 0; j < Channels; ++j)
        result[(top + i) * p.y_strides[2] + j * p.y_strides[1]] = round_to<T>(sum[i][j]);
}

template <bool Backward, class T, int Channels, class Offset>
__global__ void __launch_bounds__(32 * kMovedWarps) sum_moved(__grid_constant__ SumOfMoved<T> const p) {
  run_tile<Backward, T, Channels, Offset>(p, blockIdx.x, blockIdx.y, blockIdx.z);
}
template <bool Backward, class T, int Channels, class Offset>
__global__ void __launch_bounds__(32 * kMovedWarps) sum_moved_of_list(__grid_constant__ SumOfMovedList<T> const p) {
  int const b = p.list.sample_of(int(blockIdx.x));
  SumOfMoved<T> const one = p.sample(b);
  unsigned const block = blockIdx.x - unsigned(p.list.first[b]), across = unsigned(ceil_div(int(one.width), 32)),
                 down = unsigned(ceil_div(int(one.height), kMovedWarps * kMovedRows)), row = block / across,
                 group = row / down;
  run_tile<Backward, T, Channels, Offset>(one, block - row * across, row - group * down, group);
}

// Whether elements of a sample are counted by ints.
template <class T>
bool fits_int(SumOfMoved<T> const& p) {
  int64_t last = 0;
  int64_t const sides[] = {p.channels, p.height, p.width};
  for (int i = 0; i < 3; ++i) last += (sides[i] - 1) * p.x_strides[i + 1];
  return last <= INT32_MAX;
}

template <bool Backward, class T, int Channels>
int launch(SumOfMoved<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.width, 32)), unsigned(ceil_div(p.height, kMovedWarps * kMovedRows)),
                    unsigned(p.batch * p.channels / Channels)),
      threads(32, kMovedWarps);
  if (fits_int(p))
    sum_moved<Backward, T, Channels, int><<<blocks, threads, 0, stream>>>(p);
  else
    sum_moved<Backward, T, Channels, int64_t><<<blocks, threads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <bool Backward, class T, int Channels>
int launch_list(SumOfMovedList<T> p, CUstream_st* stream) {
  int64_t blocks = 0;
  bool are_ints = true;
  for (int b = 0; b < p.list.count; ++b) {
    SumOfMoved<T> const one = p.sample(b);
    are_ints = are_ints && fits_int(one);
    p.list.first[b] = int(blocks);
    blocks += ceil_div(one.width, 32) * ceil_div(one.height, kMovedWarps * kMovedRows) * one.channels / Channels;
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  dim3 const threads(32, kMovedWarps);
  if (are_ints)
    sum_moved_of_list<Backward, T, Channels, int><<<unsigned(blocks), threads, 0, stream>>>(p);
  else
    sum_moved_of_list<Backward, T, Channels, int64_t><<<unsigned(blocks), threads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int sum_of_moved(SumOfMoved<T> const& p, CUstream_st* stream) {
  return p.channels == 3 ? launch<false, T, 3>(p, stream) : launch<false, T, 1>(p, stream);
}
template <class T>
int sum_of_moved_list(SumOfMovedList<T> const& p, CUstream_st* stream) {
  return p.all.channels == 3 ? launch_list<false, T, 3>(p, stream) : launch_list<false, T, 1>(p, stream);
}
template <class T>
int sum_of_moved_backward(SumOfMoved<T> const& p, CUstream_st* stream) {
  return p.channels == 3 ? launch<true, T, 3>(p, stream) : launch<true, T, 1>(p, stream);
}
template <class T>
int sum_of_moved_backward_list(SumOfMovedList<T> const& p, CUstream_st* stream) {
  return p.all.channels == 3 ? launch_list<true, T, 3>(p, stream) : launch_list<true, T, 1>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(sum_of_moved, SumOfMoved)
KV_INSTANTIATE_WITH_BYTES(sum_of_moved_list, SumOfMovedList)
KV_INSTANTIATE(sum_of_moved_backward, SumOfMoved)
KV_INSTANTIATE(sum_of_moved_backward_list, SumOfMovedList)

}  // namespace kv::augmentation::cuda
