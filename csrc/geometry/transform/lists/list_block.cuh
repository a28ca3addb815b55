// The sample of a list that a block of threads takes on CUDA, in shared memory.
#pragma once

#include "geometry/transform/lists/sample_list.h"
#include "geometry/transform/sampling.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

template <class S, class Grid = TileGrid>
struct ListBlock {
  S sample;
  Grid tiles;
  static_assert(__is_trivially_copyable(S) && sizeof(S) % 4 == 0);

  // By all threads, which then see it, in shared memory: the sample of the block's index, whose tiles are those of an
  // image of `size(sample)`.
  template <class List, class SizeOf>
  static __device__ __forceinline__ ListBlock const& make(void* memory, List const& p, int tiles_per_block,
                                                          SizeOf size) {
    return make(memory, p, [&](S const& sample) {
      Size const output = size(sample);
      return TileGrid(1, output.height, output.width, tiles_per_block);
    });
  }
  // Whose tiles are `grid(sample)`.
  template <class List, class GridOf>
  static __device__ __forceinline__ ListBlock const& make(void* memory, List const& p, GridOf grid) {
    // What samples share is hundreds of bytes: one thread would copy them for longer than a block computes a tile.
    auto& block = *static_cast<ListBlock*>(memory);
    for (unsigned i = threadIdx.x; i < sizeof(S) / 4; i += blockDim.x)
      reinterpret_cast<uint32_t*>(&block.sample)[i] = reinterpret_cast<uint32_t const*>(&p.all)[i];
    int const b = threadIdx.x == 0 ? p.list.sample_of(int(blockIdx.x)) : 0;
    __syncthreads();
    if (threadIdx.x == 0) {
      set_sample(block.sample, p, b);
      new (&block.tiles) Grid(grid(block.sample));
      block.tiles.first_block = unsigned(p.list.first[b]);
    }
    __syncthreads();
    return block;
  }
};

// Whether the rows of all images of a list begin at whole vectors.
template <class T>
bool images_are_aligned(ListedSamples const& list, int channels) {
  for (int b = 0; b < list.count; ++b)
    if (!rows_are_aligned(images_of<T>(list.images[b], channels))) return false;
  return true;
}

}  // namespace
}  // namespace kv::geometry::cuda
