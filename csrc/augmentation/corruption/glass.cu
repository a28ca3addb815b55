// Pixels that read neighbors on CUDA: a thread has adjacent pixels, in all channels.
#include "augmentation/corruption/glass.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kNeighborThreads = 256;

// Four pixels a thread, whose first step has the words of one block.
template <class T>
__device__ __forceinline__ void read_pixels(ReadNeighbors<T> const& p, unsigned block, int64_t b) {
  int const width = int(p.width), pixels = int(p.height) * width,
            first = int(block * kNeighborThreads + threadIdx.x) * 4;
  if (first >= pixels) return;
  DrawSource const source = p.noise.source(b);
  bool const is_drawn = !p.noise.uniform && p.steps > 0;
  PhiloxWords words{};
  if (is_drawn) words = p.words(source, 0, first);
  T const* const x = p.x + b * p.x_strides[0];
  T* const y = p.y + b * p.y_strides[0];
  int row = first / width, column = first - row * width;
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    if (first + k >= pixels) return;
    typename ReadNeighbors<T>::Pixel at{row, column};
    if (is_drawn) at = p.moved_by(at, words.w[k]);
    for (int step = is_drawn; step < p.steps; ++step) at = p.step_from(b, source, step, at);
    T const* const from = x + at.row * p.x_strides[2] + at.column * p.x_strides[3];
    T* const to = y + row * p.y_strides[2] + column * p.y_strides[3];
    for (int c = 0; c < int(p.channels); ++c) to[c * p.y_strides[1]] = from[c * p.x_strides[1]];
    if (++column == width) column = 0, ++row;
  }
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

}  // namespace

template <class T>
int read_neighbors(ReadNeighbors<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.height * p.width, 4 * kNeighborThreads)), unsigned(p.batch));
  read_moved<T><<<blocks, kNeighborThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int read_neighbors_list(ReadNeighborsList<T> const& given, CUstream_st* stream) {
  ReadNeighborsList<T> p = given;
  int64_t blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += ceil_div(int64_t(p.list.results[b].height) * p.list.results[b].width, 4 * kNeighborThreads);
  }
  if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  read_moved_of_list<T><<<unsigned(blocks), kNeighborThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(read_neighbors, ReadNeighbors)
KV_INSTANTIATE_WITH_BYTES(read_neighbors_list, ReadNeighborsList)

}  // namespace kv::augmentation::cuda
