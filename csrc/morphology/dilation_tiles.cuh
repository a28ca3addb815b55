// Dilation by tiles in shared memory, along y and then along x: what adjacent windows have in common is combined once.
#pragma once

#include "dilation.cuh"

namespace kv::morphology::cuda {
namespace {

// Combines the windows of `size` elements that begin at 0, 1, ... N - 1. They have elements N - 1 to size - 1 in
// common.
template <int N, class Read, class Write>
__device__ __forceinline__ void combine_windows(int size, Read read, Write write) {
  auto common = read(N - 1);
#pragma unroll 4
  for (int i = N; i < size; ++i) common = combine(common, read(i));
  decltype(common) first[N];
  first[N - 1] = common;
#pragma unroll
  for (int j = N - 2; j >= 0; --j) first[j] = combine(read(j), first[j + 1]);
  write(0, first[0]);
  if constexpr (N > 1) {
    auto behind = read(size);
#pragma unroll
    for (int j = 1; j < N; ++j) {
      if (j > 1) behind = combine(behind, read(size + j - 1));
      write(j, combine(first[j], behind));
    }
  }
}

// Calls f(position, group) for all groups of windows at `positions` positions, divided among the threads of a block.
template <class Call>
__device__ __forceinline__ void for_each_group(int positions, int groups, Call f) {
  for (int i = threadIdx.x; i < positions * groups; i += int(blockDim.x)) {
    int const group = i / positions;
    f(i - group * positions, group);
  }
}

// Calls f(row, column) for all pixels of a tile; the warps of a block take its rows.
template <class Call>
__device__ __forceinline__ void for_each_pixel(int rows, int columns, Call f) {
#pragma unroll 1
  for (int row = threadIdx.x / 32; row < rows; row += int(blockDim.x) / 32)
    for (int column = threadIdx.x % 32; column < columns; column += 32) f(row, column);
}

// The tile of a block: its plane, and its first row and column.
struct Tile {
  int64_t plane;
  int y, x;
  __device__ __forceinline__ Tile(int across, int down, int rows, int columns) {
    unsigned const line = blockIdx.x / unsigned(across), p = line / unsigned(down);
    plane = p, y = int(line - p * down) * rows, x = int(blockIdx.x - line * across) * columns;
  }
};

// Calls f(N) with the number of adjacent windows of `size` elements that a thread computes at once.
template <class Call>
__device__ __forceinline__ void dispatch_group_size(int size, Call f) {
  if (size >= 15)
    f(std::integral_constant<int, 15>{});
  else if (size >= 5)
    f(std::integral_constant<int, 5>{});
  else
    f(std::integral_constant<int, 1>{});
}

// Whether the window of a sample is flat, by all threads of a block.
template <class F>
__device__ __forceinline__ bool is_flat(StructuringElement<F> const& window, int64_t sample) {
  bool flat = true;
  for (int i = threadIdx.x; i < window.height * window.width; i += int(blockDim.x))
    flat = flat && window.offset(sample, i) == 0;
  return __syncthreads_and(flat);
}

// Launches a kernel with one block for each tile of `rows` rows and `columns` columns.
template <class Params, class Image>
int launch_tiles(void (*kernel)(Params, int, int), Params const& params, Image const& image, int rows, int columns,
                 int threads, int64_t bytes, CUstream_st* stream) {
  int const across = int(ceil_div(image.width, columns)), down = int(ceil_div(image.height, rows));
  if (int error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes))) return error;
  kernel<<<unsigned(image.count() * across * down), threads, bytes, stream>>>(params, across, down);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::morphology::cuda
