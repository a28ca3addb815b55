// The gradients of the images of a list that maps read, on CUDA, in one launch that adds to zeros, by the method of
// sampling_image_backward.cu.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/lists/remap_list.h"
#include "geometry/transform/sampling_blocks/scatter.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K>
__global__ void __launch_bounds__(32 * kScatterWarps, sizeof(T) == 8 ? 4 : 6)
    scatter_mapped(__grid_constant__ RemapListBackward<T> const p) {
  using Block = ListBlock<SampleImageBackward<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block =
      Block::make(memory, p, 1, [](SampleImageBackward<T> const& s) -> Size { return {s.grad.height, s.grad.width}; });
  scatter_block<K>(block.sample, block.tiles);
}

}  // namespace

template <class T>
int remap_list_backward(RemapListBackward<T> const& p, CUstream_st* stream) {
  dispatch_taps(p.all.interpolation, [&](auto taps) {
    int const channels = p.channels.only < 0 ? p.channels.count : 1;
    scatter_mapped<T, taps.value>
        <<<unsigned(p.list.items), 32 * kScatterWarps, Sums<Compute<T>>::bytes(channels), stream>>>(p);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(remap_list_backward, RemapListBackward)

}  // namespace kv::geometry::cuda
