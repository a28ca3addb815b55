// Antialiased warps of lists of images on CUDA, in one launch: a block finds its image in the table, and samples as
// blocks of batches do.
#include "geometry/transform/antialiased/sample_covered.cuh"
#include "geometry/transform/lists/list_block.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : kBlocks)
    sample_covered_list(__grid_constant__ SampleList<T> const p) {
  using Block = ListBlock<Sample<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block = Block::make(memory, p, 1, [](Sample<T> const& s) -> Size { return {s.y.height, s.y.width}; });
  if constexpr (sizeof(T) < 8) {
    sample_tile_in_parts(block.sample, block.tiles, rows_are_fours(block.sample.x));
  } else {
    __shared__ Tile<Compute<T>> tile;
    tile.init_for_block(block.tiles, block.sample);
    sample_unstaged(block.sample, tile, 0, 1);
  }
}

}  // namespace

template <class T>
int sample_antialiased_list(SampleList<T> const& p, CUstream_st* stream) {
  int64_t source = 0, pixels = 0;
  for (int b = 0; b < p.list.count; ++b) {
    source += int64_t(p.list.images[b].height) * p.list.images[b].width;
    pixels += int64_t(p.list.results[b].height) * p.list.results[b].width;
  }
  constexpr bool kByParts = sizeof(T) < 8;
  unsigned const blocks = kByParts ? blocks_of_tile(p.list.items, source, pixels) : 1;
  int const bytes = kByParts ? kPartsBytes : 0;
  sample_covered_list<T><<<dim3(unsigned(p.list.items), blocks), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased_list, SampleList)

}  // namespace kv::geometry::cuda
