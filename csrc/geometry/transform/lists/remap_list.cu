// Maps of lists of images on CUDA, in one launch: a block finds its image in the table, and samples as blocks of
// batches do.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/lists/remap_list.h"
#include "geometry/transform/sampling_blocks/sample.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    remap_list_tiles(__grid_constant__ RemapList<T> const p, int tiles_per_block) {
  using Block = ListBlock<Sample<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block =
      Block::make(memory, p, tiles_per_block, [](Sample<T> const& s) -> Size { return {s.y.height, s.y.width}; });
  Sample<T> const& sample = block.sample;
  remap_block<K, Aligned>(sample, block.tiles, has_whole_vectors(sample.coords, sample.y.width));
}

template <class T>
bool all_are_aligned(RemapList<T> const& p) {
  for (int b = 0; b < p.list.count; ++b)
    if (!rows_are_aligned(sample_at(p, b).x)) return false;
  return true;
}

}  // namespace

template <class T>
int remap_list(RemapList<T> const& p, CUstream_st* stream) {
  with_alignment<T>(all_are_aligned(p), [&](auto aligned) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      int const channels = p.channels.only < 0 ? p.channels.count : 1;
      remap_list_tiles<T, taps.value, aligned.value>
          <<<unsigned(p.list.items), kThreads, SourceTile<T, aligned.value>::bytes(channels, p.all.coords), stream>>>(
              p, p.tiles_per_block);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(remap_list, RemapList)

}  // namespace kv::geometry::cuda
