// Maps of lists of images on CUDA, in one launch: a block finds its image in the table, and samples as blocks of
// batches do.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/lists/remap_list.h"
#include "geometry/transform/sampling_blocks/sample.cuh"
#include "geometry/transform/sampling_blocks/sample_bytes.cuh"

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

__global__ void __launch_bounds__(kThreads, kByteMapBlocks)
    remap_byte_list_tiles(__grid_constant__ RemapList<uint8_t> const p, int tiles_per_block) {
  using Block = ListBlock<Sample<uint8_t>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  Block const& block =
      Block::make(memory, p, tiles_per_block, [](Sample<uint8_t> const& s) -> Size { return {s.y.height, s.y.width}; });
  if (rows_are_dense(block.sample.y))
    sample_byte_tiles_of_maps<true>(block.sample, shared_pixels, block.tiles);
  else
    sample_byte_tiles_of_maps<false>(block.sample, shared_pixels, block.tiles);
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
  if constexpr (sizeof(T) == 1)
    if (p.all.interpolation == Interpolation::bilinear) {
      remap_byte_list_tiles<<<unsigned(p.list.items), kThreads, ByteSource::kBytes, stream>>>(p, p.tiles_per_block);
      return cudaGetLastError();
    }
  with_alignment<T>(all_are_aligned(p), [&](auto aligned) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      int const channels = p.channels.only < 0 ? p.channels.count : 1;
      if constexpr (sizeof(T) > 1 || taps.value != 2)
        remap_list_tiles<T, taps.value, aligned.value>
            <<<unsigned(p.list.items), kThreads, SourceTile<T, aligned.value>::bytes(channels, p.all.coords), stream>>>(
                p, p.tiles_per_block);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(remap_list, RemapList)

}  // namespace kv::geometry::cuda
