// The gradients of sampling coordinates and matrices on CUDA; see sampling.h.
#include "geometry/transform/sampling_blocks/differentiate.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, kDifferentiateBlocks<T, K>)
    coords_backward_tiles(__grid_constant__ SampleCoordsBackward<T> const p, TileGrid tiles) {
  differentiate_block<K, Aligned>(p, tiles);
}

// One block per sample.
template <class T>
__global__ void reduce_matrix_grads(WarpMatrixBackward<T> p) {
  reduce_matrix_sums(p, blockIdx.x);
}

}  // namespace

template <class T>
int sample_coords_backward(SampleCoordsBackward<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width,
                       tiles_per_block(p.grad.batch, p.grad.height, p.grad.width));
  with_alignment_of(p.x, [&](auto aligned) {
    dispatch_taps(p.interpolation, [&](auto taps) {
      coords_backward_tiles<T, taps.value, aligned.value>
          <<<tiles.blocks, kThreads, SourceTile<T, aligned.value>::bytes(p.x.channels, p.coords), stream>>>(p, tiles);
    });
  });
  return cudaGetLastError();
}

template <class T>
int warp_matrix_backward(WarpMatrixBackward<T> const& p, CUstream_st* stream) {
  reduce_matrix_grads<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_coords_backward, SampleCoordsBackward)
KV_INSTANTIATE_COMPUTED(warp_matrix_backward, WarpMatrixBackward)

}  // namespace kv::geometry::cuda
