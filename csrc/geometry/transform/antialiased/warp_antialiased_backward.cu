// The gradients of antialiased sampling on CUDA: gathered to the images of affine maps, by atomic additions to others,
// sums to matrices, one number for each coordinate of maps.
#include "geometry/transform/antialiased/differentiate_covered.cuh"
#include "geometry/transform/antialiased/scatter_covered.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads, kGatherBlocks<T>)
    gather_covered(__grid_constant__ SampleImageBackward<T> const p, unsigned across, unsigned down) {
  unsigned const line = blockIdx.x / across, sample = line / down;
  gather_covered_block(p, sample, blockIdx.x - line * across, line - sample * down);
}

// A block has `chunk` tiles.
template <class T>
__global__ void __launch_bounds__(kThreads, kScatterBlocks<T>)
    scatter_covered(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, unsigned chunk,
                    bool some_gather) {
  scatter_tiles(p, tiles, blockIdx.x * chunk, min((blockIdx.x + 1) * chunk, tiles.blocks), some_gather);
}

template <class T>
__global__ void __launch_bounds__(kThreads, 1)
    differentiate_maps(__grid_constant__ AntialiasedCoordsBackward<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  tile.init_for_block(tiles, p);
  F sums[9];  // of matrices
  differentiate_unstaged(p, tile, sums);
}

template <class T>
__global__ void __launch_bounds__(kThreads, kDifferentiateBlocks<T>)
    differentiate_covered(__grid_constant__ AntialiasedCoordsBackward<T> const p, TileGrid tiles, bool aligned) {
  differentiate_block(p, tiles, aligned);
}

template <class F>
__global__ void __launch_bounds__(kThreads) add_differences(__grid_constant__ MapDifferencesBackward<F> const p) {
  int64_t const pixels = p.grad_x.height * p.grad_x.width, i = int64_t(blockIdx.x) * kThreads + threadIdx.x;
  if (i >= p.grad_x.batch * pixels) return;
  int64_t const b = i / pixels, at = i - b * pixels, y = at / p.grad_x.width;
  p.add(b, y, at - y * p.grad_x.width);
}

}  // namespace

template <class T>
int sample_antialiased_image_backward(SampleImageBackward<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width, 1);
  bool const gathers = !p.coords.has_map() && p.is_one_sample_per_image();
  if (gathers) {
    auto const& x = p.grad_x;
    unsigned const across = unsigned(ceil_div(x.width, kGatherTile)), down = unsigned(ceil_div(x.height, kGatherTile));
    unsigned const blocks = unsigned(x.batch) * across * down;
    if (blocks > 0) gather_covered<T><<<blocks, kThreads, gather_bytes<T>(x.channels), stream>>>(p, across, down);
  } else {
    int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
    cudaError_t const error = cudaMemsetAsync(p.sums, 0, size_t(count) * sizeof(Compute<T>), stream);
    if (error != cudaSuccess) return error;
  }
  unsigned const chunk = scattered_tiles(p, tiles.blocks, gathers);
  if (tiles.blocks > 0)
    scatter_covered<T><<<ceil_div(tiles.blocks, chunk), kThreads, 0, stream>>>(p, tiles, chunk, gathers);
  return cudaGetLastError();
}

template <class T>
int sample_antialiased_coords_backward(AntialiasedCoordsBackward<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.grad.batch, p.grad.height, p.grad.width, 1);
  if (p.coords.has_map())
    differentiate_maps<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  else
    differentiate_covered<T>
        <<<tiles.blocks, kThreads, differentiate_bytes<T>(p.x.channels), stream>>>(p, tiles, rows_are_fours(p.x));
  return cudaGetLastError();
}

template <class T>
int map_differences_backward(MapDifferencesBackward<T> const& p, CUstream_st* stream) {
  int64_t const pixels = p.grad_x.batch * p.grad_x.height * p.grad_x.width;
  add_differences<T><<<unsigned(ceil_div(pixels, int64_t(kThreads))), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_antialiased_image_backward, SampleImageBackward)
KV_INSTANTIATE(sample_antialiased_coords_backward, AntialiasedCoordsBackward)
KV_INSTANTIATE_COMPUTED(map_differences_backward, MapDifferencesBackward)

}  // namespace kv::geometry::cuda
