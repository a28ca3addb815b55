// Antialiased sampling on CUDA: by a matrix from source tiles in shared memory (covered_parts.cuh); by maps, and in
// float64, from global memory by way of the L1 (antialiased.cuh).
#include "geometry/transform/antialiased/sample_covered.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 4)
    sample_covered(__grid_constant__ Sample<T> const p, TileGrid tiles) {
  __shared__ Tile<Compute<T>> tile;
  tile.init_for_block(tiles, p);
  sample_unstaged(p, tile, 0, 1);
}

template <class T>
__global__ void __launch_bounds__(kThreads, kBlocks)
    sample_by_parts(__grid_constant__ Sample<T> const p, TileGrid const tiles, bool aligned) {
  sample_tile_in_parts(p, tiles, aligned);
}

}  // namespace

template <class T>
int sample_antialiased(Sample<T> const& p, CUstream_st* stream) {
  TileGrid const tiles(p.y.batch, p.y.height, p.y.width, 1);
  if constexpr (sizeof(T) < 8) {
    if (!p.coords.has_map()) {
      unsigned const splits = blocks_of_tile(tiles.blocks, p.x.height * p.x.width, p.y.height * p.y.width);
      sample_by_parts<T><<<dim3(tiles.blocks, splits), kThreads, kPartsBytes, stream>>>(p, tiles, rows_are_fours(p.x));
      return cudaGetLastError();
    }
  }
  sample_covered<T><<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased, Sample)

}  // namespace kv::geometry::cuda
