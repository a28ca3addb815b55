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
    if (threadIdx.x == 0) {
      int const b = p.list.sample_of(int(blockIdx.x));
      S const sample = sample_at(p, b);
      Grid tiles = grid(sample);
      tiles.first_block = unsigned(p.list.first[b]);
      new (memory) ListBlock{sample, tiles};
    }
    __syncthreads();
    return *static_cast<ListBlock const*>(memory);
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
