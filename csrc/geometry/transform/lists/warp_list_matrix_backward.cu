// The gradients of the matrices of lists on CUDA, by the methods of sampling_coords_backward.cu: their sums in one
// launch, which another one adds up.
#include "geometry/transform/lists/list_block.cuh"
#include "geometry/transform/sampling_blocks/differentiate.cuh"

namespace kv::geometry::cuda {
namespace {

// Half as many blocks as for batches, and registers for what a block's sample has in shared memory.
template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, kDifferentiateBlocks<T, K> / 2)
    differentiate_list(__grid_constant__ SampleListMatrixBackward<T> const p) {
  using Sample = SampleCoordsBackward<T>;
  using Block = ListBlock<Sample>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block =
      Block::make(memory, p, p.tiles_per_block, [](Sample const& s) -> Size { return {s.grad.height, s.grad.width}; });
  differentiate_block<K, Aligned>(block.sample, block.tiles);
}

// One block per sample.
template <class T>
__global__ void reduce_list_matrix_grads(__grid_constant__ WarpMatrixListBackward<T> const p) {
  reduce_matrix_sums(sample_at(p, int(blockIdx.x)), 0);
}

}  // namespace

template <class T>
int sample_list_matrix_backward(SampleListMatrixBackward<T> const& p, CUstream_st* stream) {
  int const channels = p.all.x.channels;
  with_alignment<T>(images_are_aligned<T>(p.list, channels), [&](auto aligned) {
    dispatch_taps(p.all.interpolation, [&](auto taps) {
      differentiate_list<T, taps.value, aligned.value>
          <<<unsigned(p.list.items), kThreads, SourceTile<T, aligned.value>::bytes(channels), stream>>>(p);
    });
  });
  return cudaGetLastError();
}

template <class T>
int warp_matrix_list_backward(WarpMatrixListBackward<T> const& p, CUstream_st* stream) {
  reduce_list_matrix_grads<T><<<unsigned(p.list.count), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_list_matrix_backward, SampleListMatrixBackward)
KV_INSTANTIATE_COMPUTED(warp_matrix_list_backward, WarpMatrixListBackward)

}  // namespace kv::geometry::cuda
