// Antialiased resizing of windows of lists on CUDA, and its gradient: a block finds its image in the table, and resizes
// as blocks of batches do.
#include <algorithm>
#include <utility>

#include "geometry/transform/lists/resize_windows_list.h"
#include "geometry/transform/resize/resize_windows.cuh"

namespace kv::geometry::cuda {
namespace {

// The sample that a block takes, and its tiles, in shared memory.
template <class T>
struct WindowBlock {
  ResizeWindows<T> sample;
  WindowTiles tiles;
  unsigned block;  // among those of the sample

  static __device__ __forceinline__ void init(void* memory, ResizeWindowsList<T> const& p, WindowTiles tiles) {
    int const b = p.list.sample_of(int(blockIdx.x));
    ResizeWindows<T> const sample = sample_at(p, b);
    tiles.across = unsigned(ceil_div(int(sample.y.width), tiles.columns));
    tiles.down = unsigned(ceil_div(int(sample.y.height), tiles.rows));
    new (memory) WindowBlock{sample, tiles, blockIdx.x - unsigned(p.list.first[b])};
  }
};

template <class T, int P, int R>
__global__ void __launch_bounds__(kThreads, kBlocks)
    resize_list_tiles(__grid_constant__ ResizeWindowsList<T> const p, WindowTiles const tiles) {
  __shared__ __align__(16) unsigned char memory[sizeof(WindowBlock<T>)];
  if (threadIdx.x == 0) WindowBlock<T>::init(memory, p, tiles);
  __syncthreads();
  auto const& own = *reinterpret_cast<WindowBlock<T> const*>(memory);
  resize_tile<T, P, R>(own.sample, own.tiles, own.block);
}

template <class T>
__global__ void __launch_bounds__(kElements) resize_list_any(__grid_constant__ ResizeWindowsList<T> const p) {
  __shared__ __align__(16) unsigned char memory[sizeof(WindowBlock<T>)];
  if (threadIdx.x == 0) WindowBlock<T>::init(memory, p, {0, 0, 0, 1, 1, 0, 0, 0});
  __syncthreads();
  auto const& own = *reinterpret_cast<WindowBlock<T> const*>(memory);
  resize_element(own.sample, own.block);
}

// Images that shrink most along y come first: their blocks take longest, and would run alone at the end.
template <class T>
ResizeWindowsList<T> largest_first(ResizeWindowsList<T> const& params) {
  ResizeWindowsList<T> p = params;
  if (p.all.matrices || p.all.backward) return p;
  std::pair<double, int> order[kMaxListed];
  for (int b = 0; b < p.list.count; ++b)
    order[b] = {-double(p.list.images[b].height) / max(p.list.results[b].height, 1), b};
  std::sort(order, order + p.list.count);
  for (int i = 0; i < p.list.count; ++i) {
    p.list.images[i] = params.list.images[order[i].second];
    p.list.results[i] = params.list.results[order[i].second];
  }
  return p;
}

// Sets where the blocks of each sample begin, and returns their number.
template <class T, class BlocksOf>
int64_t divide(ResizeWindowsList<T>& p, BlocksOf blocks_of) {
  int64_t blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += blocks_of(int64_t(p.list.results[b].height), int64_t(p.list.results[b].width));
  }
  return blocks <= INT32_MAX ? blocks : 0;
}

// The size of an image of which a result with `most` pixels reads as many for each as one with `result` pixels does.
inline int64_t stretched(int64_t source, int64_t result, int64_t most, bool align_corners) {
  if (!align_corners) return ceil_div(source * most, result);
  return result > 1 ? ceil_div((source - 1) * (most - 1), result - 1) + 1 : source;
}

// A batch with the largest sides and the most taps of all samples, whose tiles serve each of them.
template <class T>
ResizeWindows<T> largest_of(ResizeWindowsList<T> const& p, bool& fits, bool& near) {
  ResizeWindows<T> largest = sample_at(p, 0);
  fits = near = true;
  for (int b = 0; b < p.list.count; ++b) {
    ResizeWindows<T> const one = sample_at(p, b);
    fits = fits && fits_tiles(one.x) && fits_tiles(one.y);
    near = near && has_near_planes(one.x) && has_near_planes(one.y);
    fits = fits && fits_coordinates(one);
    largest.x.height = max(largest.x.height, one.x.height);
    largest.x.width = max(largest.x.width, one.x.width);
    largest.y.height = max(largest.y.height, one.y.height);
    largest.y.width = max(largest.y.width, one.y.width);
  }
  for (int b = 0; b < p.list.count && fits && !p.all.backward; ++b) {
    ResizeWindows<T> const one = sample_at(p, b);
    int64_t const height = stretched(one.x.height, one.y.height, largest.y.height, p.all.align_corners);
    int64_t const width = stretched(one.x.width, one.y.width, largest.y.width, p.all.align_corners);
    largest.x.height = max(largest.x.height, height);
    largest.x.width = max(largest.x.width, width);
    fits = fits && fits_coordinates(height, largest.y.height) && fits_coordinates(width, largest.y.width);
  }
  largest.y.outer *= p.list.count;
  return largest;
}

template <class T>
int resize_tiles(ResizeWindowsList<T>& p, ResizeWindows<T> const& largest, bool near, CUstream_st* stream) {
  bool const by_groups = largest.planes % kPlanes == 0 && largest.x.step == 1 && near;
  return dispatch_tiles(
      largest, by_groups, [&](auto planes, auto radius, WindowTiles const& tiles, int threads) -> int {
        auto* const kernel = resize_list_tiles<T, planes.value, radius.value>;
        if (int const error =
                cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(tiles.bytes)))
          return error;
        int64_t const blocks = divide(p, [&](int64_t height, int64_t width) {
          return int64_t(tiles.groups) * ceil_div(height, int64_t(tiles.rows)) *
                 ceil_div(width, int64_t(tiles.columns));
        });
        kernel<<<unsigned(blocks), threads, unsigned(tiles.bytes), stream>>>(p, tiles);
        return cudaGetLastError();
      });
}

}  // namespace

template <class T>
int resize_windows_list(ResizeWindowsList<T> const& params, CUstream_st* stream) {
  ResizeWindowsList<T> p = largest_first(params);
  if constexpr (sizeof(T) <= 2)
    // Special case, H200: 1.3 (float16, by 0.6 to 0.95) to 1.9 (bytes, photographs to 224x224) times as fast as strips.
    if (int const error = resize_columns_list(p, stream); error != cudaSuccess || p.list.count == 0) return error;
  if constexpr (sizeof(T) < 8) {
    if (int const error = resize_strips_list(p, stream); error != kUnsupported) return error;
    bool fits, near;
    ResizeWindows<T> const largest = largest_of(p, fits, near);
    int const error = fits ? resize_tiles(p, largest, near, stream) : kUnsupported;
    if (error != kUnsupported) return error;
  }
  int64_t const blocks = divide(
      p, [&](int64_t height, int64_t width) { return ceil_div(height * width * p.channels, int64_t(kElements)); });
  resize_list_any<<<unsigned(blocks), kElements, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(resize_windows_list, ResizeWindowsList)

}  // namespace kv::geometry::cuda
