// The gradients of the images of a list on CUDA, in one launch, by the methods of
// sampling_image_backward.cu.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/sampling_blocks/gather.cuh"
#include "geometry/transform/sampling_blocks/scatter.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 5)
    gather_list(__grid_constant__ SampleListBackward<T> const p, int tiles_per_block) {
  using Block = ListBlock<SampleImageBackward<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block = Block::make(memory, p, tiles_per_block, [](SampleImageBackward<T> const& s) -> Size {
    return {s.grad_x.height, s.grad_x.width};
  });
  auto const& grad_x = block.sample.grad_x;
  bool const aligned_out = grad_x.width * int64_t(sizeof(T)) % 16 == 0;  // images of a list begin at vectors
  gather_block<K, Aligned>(block.sample, block.tiles, aligned_out);
}

template <class T, int K>
__global__ void __launch_bounds__(32 * kScatterWarps, sizeof(T) == 8 ? 4 : 6)
    scatter_list(__grid_constant__ SampleListBackward<T> const p) {
  using Block = ListBlock<SampleImageBackward<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block =
      Block::make(memory, p, 1, [](SampleImageBackward<T> const& s) -> Size { return {s.grad.height, s.grad.width}; });
  scatter_block<K>(block.sample, block.tiles);
}

}  // namespace

template <class T>
int sample_list_backward(SampleListBackward<T> const& p, CUstream_st* stream) {
  int const channels = p.all.grad.channels;
  if (p.all.x_axis.padding != Padding::fill) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      scatter_list<T, taps.value>
          <<<unsigned(p.list.items), 32 * kScatterWarps, Sums<Compute<T>>::bytes(channels), stream>>>(p);
    });
    return cudaGetLastError();
  }
  with_alignment<T>(images_are_aligned<T>(p.list, channels), [&](auto aligned) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      gather_list<T, taps.value, aligned.value>
          <<<unsigned(p.list.items), kThreads, SourceTile<T, aligned.value>::bytes(channels), stream>>>(
              p, p.tiles_per_block);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_list_backward, SampleListBackward)

}  // namespace kv::geometry::cuda
