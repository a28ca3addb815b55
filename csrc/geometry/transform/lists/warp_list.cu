// Warps of lists of images on CUDA, in one launch: a block finds its image in the table, and samples as blocks of
// batches do.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/sampling_blocks/sample.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    sample_list_tiles(__grid_constant__ SampleList<T> const p, int tiles_per_block) {
  using Block = ListBlock<Sample<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block =
      Block::make(memory, p, tiles_per_block, [](Sample<T> const& s) -> Size { return {s.y.height, s.y.width}; });
  sample_block<K, false, Aligned>(block.sample, block.tiles);
}

}  // namespace

template <class T>
int sample_list(SampleList<T> const& p, CUstream_st* stream) {
  int const channels = p.all.x.channels;
  with_alignment<T>(images_are_aligned<T>(p.list, channels), [&](auto aligned) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      sample_list_tiles<T, taps.value, aligned.value>
          <<<unsigned(p.list.items), kThreads, SourceTile<T, aligned.value>::bytes(channels), stream>>>(
              p, p.tiles_per_block);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_list, SampleList)

}  // namespace kv::geometry::cuda
