// Pixels that read neighbors on CUDA: a thread has adjacent pixels, in all channels.
#include "augmentation/corruption/glass.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kNeighborThreads = 256;

// Calls use(pixel, the one that it reads) for four pixels a thread, whose first step has the words of one block.
template <class T, class Use>
__device__ __forceinline__ void move_pixels(ReadNeighbors<T> const& p, unsigned block, int64_t b, Use use) {
  int const width = int(p.width), pixels = int(p.height) * width,
            first = int(block * kNeighborThreads + threadIdx.x) * 4;
  if (first >= pixels) return;
  DrawSource const source = p.noise.source(b);
  bool const is_drawn = !p.noise.uniform && p.steps > 0;
  PhiloxWords words{};
  if (is_drawn) words = p.words(source, 0, first);
  int row = first / width, column = first - row * width;
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    if (first + k >= pixels) return;
    typename ReadNeighbors<T>::Pixel const own{row, column};
    typename ReadNeighbors<T>::Pixel at = own;
    if (is_drawn) at = p.moved_by(at, words.w[k]);
    for (int step = is_drawn; step < p.steps; ++step) at = p.step_from(b, source, step, at);
    use(own, at);
    if (++column == width) column = 0, ++row;
  }
}

template <class T>
__device__ __forceinline__ void read_pixels(ReadNeighbors<T> const& p, unsigned block, int64_t b) {
  T const* const x = p.x + b * p.x_strides[0];
  T* const y = p.y + b * p.y_strides[0];
  move_pixels(p, block, b, [&](auto own, auto at) {
    T const* const from = x + at.row * p.x_strides[2] + at.column * p.x_strides[3];
    T* const to = y + own.row * p.y_strides[2] + own.column * p.y_strides[3];
    for (int c = 0; c < int(p.channels); ++c) to[c * p.y_strides[1]] = from[c * p.x_strides[1]];
  });
}

template <class T>
__global__ void __launch_bounds__(kNeighborThreads) read_moved(__grid_constant__ ReadNeighbors<T> const p) {
  read_pixels(p, blockIdx.x, blockIdx.y);
}
template <class T>
__global__ void __launch_bounds__(kNeighborThreads) read_moved_of_list(__grid_constant__ ReadNeighborsList<T> const p) {
  int const b = p.list.sample_of(int(blockIdx.x));
  read_pixels(p.sample(b), blockIdx.x - unsigned(p.list.first[b]), 0);
}
template <class T>
__global__ void __launch_bounds__(kNeighborThreads)
    add_to_neighbors(__grid_constant__ ReadNeighborsBackwardList<T> const p) {
  using F = Compute<T>;
  int const b = p.list.sample_of(int(blockIdx.x));
  ReadNeighbors<T> const one = p.sample(b);
  F* const sums = p.sums(b);
  move_pixels(one, blockIdx.x - unsigned(p.list.first[b]), 0, [&](auto own, auto at) {
    T const* const from = one.x + own.row * one.x_strides[2] + own.column * one.x_strides[3];
    F* const to = sums + at.row * one.y_strides[2] + at.column * one.y_strides[3];
    for (int c = 0; c < int(one.channels); ++c)
      atomicAdd(to + c * one.y_strides[1], F(read(from[c * one.x_strides[1]])));
  });
}

// Launches the kernel with the blocks of all images.
template <class List>
int launch_moves(List p, void (*kernel)(List), CUstream_st* stream) {
  int64_t blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += ceil_div(int64_t(p.list.results[b].height) * p.list.results[b].width, 4 * kNeighborThreads);
  }
  if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  kernel<<<unsigned(blocks), kNeighborThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int read_neighbors(ReadNeighbors<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.height * p.width, 4 * kNeighborThreads)), unsigned(p.batch));
  read_moved<T><<<blocks, kNeighborThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int read_neighbors_list(ReadNeighborsList<T> const& p, CUstream_st* stream) {
  return launch_moves(p, &read_moved_of_list<T>, stream);
}
template <class T>
int read_neighbors_list_backward(ReadNeighborsBackwardList<T> const& p, CUstream_st* stream) {
  return launch_moves(p, &add_to_neighbors<T>, stream);
}

KV_INSTANTIATE_WITH_BYTES(read_neighbors, ReadNeighbors)
KV_INSTANTIATE_WITH_BYTES(read_neighbors_list, ReadNeighborsList)
KV_INSTANTIATE(read_neighbors_list_backward, ReadNeighborsBackwardList)

}  // namespace kv::augmentation::cuda
