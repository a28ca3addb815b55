// Sampling of batches on CUDA.
#include "geometry/transform/sampling_blocks/sample.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K, bool ByFormula, bool Aligned>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    sample_tiles(__grid_constant__ Sample<T> const p, TileGrid tiles) {
  sample_block<K, ByFormula, Aligned>(p, tiles);
}

}  // namespace

template <class T>
int sample(Sample<T> const& p, CUstream_st* stream) {
  int const per_block = tiles_per_block(p.y.batch, p.y.height, p.y.width);
  // Special case, H200: 1.12 to 1.14 times as fast as a tile of each image.
  bool const one_map = p.coords.has_map() && p.coords.x.batch_stride == 0 && p.coords.y.batch_stride == 0;
  TileGrid const tiles(p.y.batch, p.y.height, p.y.width, per_block, one_map && p.y.batch >= per_block);
  with_alignment_of(p.x, [&](auto aligned) {
    auto const run = [&](auto kernel) {
      kernel<<<tiles.blocks, kThreads, SourceTile<T, aligned.value>::bytes(p.x.channels, p.coords), stream>>>(p, tiles);
    };
    dispatch_taps(p.interpolation, [&](auto taps) {
      constexpr int K = taps.value;
      p.formula.id == WarpFormula::none ? run(sample_tiles<T, K, false, aligned.value>)
                                        : run(sample_tiles<T, K, true, aligned.value>);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample, Sample)

}  // namespace kv::geometry::cuda
