// Warps of lists of images on CUDA, in one launch: a block finds its image in the table, and samples as blocks of
// batches do.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/sampling_blocks/sample.cuh"
#include "geometry/transform/sampling_blocks/sample_bytes.cuh"

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

__global__ void __launch_bounds__(kThreads, kByteBlocks)
    sample_byte_list_tiles(__grid_constant__ SampleList<uint8_t> const p) {
  using Block = ListBlock<Sample<uint8_t>, ByteGrid>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  __shared__ ByteBlock parts;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  Block const& block =
      Block::make(memory, p, [&](Sample<uint8_t> const& s) { return ByteGrid(s.y.height, s.y.width, p.byte_side); });
  Sample<uint8_t> const& sample = block.sample;
  parts.prepare(sample, shared_pixels, block.tiles, [&](int64_t) { return sample.coords.matrices; });
  if (rows_are_dense(sample.y))
    parts.sample<true>(sample, shared_pixels);
  else
    parts.sample<false>(sample, shared_pixels);
}

}  // namespace

template <class T>
int sample_list(SampleList<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 1) {
    if (p.all.interpolation == Interpolation::bilinear) {
      sample_byte_list_tiles<<<unsigned(p.list.items), kThreads, ByteSource::kBytes, stream>>>(p);
      return cudaGetLastError();
    }
  }
  int const channels = p.all.x.channels;
  with_alignment<T>(images_are_aligned<T>(p.list, channels), [&](auto aligned) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      if constexpr (sizeof(T) > 1 || taps.value != 2)
        sample_list_tiles<T, taps.value, aligned.value>
            <<<unsigned(p.list.items), kThreads, SourceTile<T, aligned.value>::bytes(channels), stream>>>(
                p, p.tiles_per_block);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_list, SampleList)

}  // namespace kv::geometry::cuda
