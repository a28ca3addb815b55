// The gradients of antialiased warps of lists on CUDA, by the methods of warp_antialiased_backward.cu: of the images in
// two launches, of the matrices in one before that of warp_list_matrix_backward.cu.
#include "geometry/transform/antialiased/differentiate_covered.cuh"
#include "geometry/transform/antialiased/scatter_covered.cuh"
#include "geometry/transform/lists/list_block.cuh"

namespace kv::geometry::cuda {
namespace {

// The tiles of an image that are gathered.
struct GatherGrid {
  unsigned across, first_block;
};

template <class T>
__global__ void __launch_bounds__(kThreads, kGatherBlocks<T>)
    gather_covered_list(__grid_constant__ SampleListBackward<T> const p) {
  using Block = ListBlock<SampleImageBackward<T>, GatherGrid>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block = Block::make(memory, p, [](SampleImageBackward<T> const& s) {
    return GatherGrid{unsigned(ceil_div(s.grad_x.width, kGatherTile)), 0};
  });
  unsigned const number = blockIdx.x - block.tiles.first_block, row = number / block.tiles.across;
  gather_covered_block(block.sample, 0, number - row * block.tiles.across, row);
}

template <class T>
__global__ void __launch_bounds__(kThreads, kScatterBlocks<T>)
    scatter_covered_list(__grid_constant__ SampleListBackward<T> const p, unsigned chunk) {
  using Block = ListBlock<SampleImageBackward<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block =
      Block::make(memory, p, 1, [](SampleImageBackward<T> const& s) -> Size { return {s.grad.height, s.grad.width}; });
  unsigned const begin = (blockIdx.x - block.tiles.first_block) * chunk;
  scatter_tiles(block.sample, block.tiles, begin, min(begin + chunk, block.tiles.blocks), true);
}

template <class T>
__global__ void __launch_bounds__(kThreads, kDifferentiateBlocks<T>)
    differentiate_covered_list(__grid_constant__ AntialiasedListMatrixBackward<T> const p) {
  using Sample = AntialiasedCoordsBackward<T>;
  using Block = ListBlock<Sample>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block = Block::make(memory, p, 1, [](Sample const& s) -> Size { return {s.grad.height, s.grad.width}; });
  differentiate_block(block.sample, block.tiles, rows_are_fours(block.sample.x));
}

}  // namespace

template <class T>
int sample_antialiased_list_backward(SampleListBackward<T> const& p, CUstream_st* stream) {
  gather_covered_list<T><<<unsigned(p.list.items), kThreads, gather_bytes<T>(p.all.grad.channels), stream>>>(p);
  SampleListBackward<T> rest = p;  // whose items are tiles of the gradients that are read
  auto const tiles_of = [&](int b) {
    ListedImage const& grad = p.list.images[b];
    return int64_t(TileGrid(1, grad.height, grad.width, 1).blocks);
  };
  int64_t tiles = 0;
  for (int b = 0; b < p.list.count; ++b) tiles += tiles_of(b);
  unsigned const chunk = scattered_tiles(p.all, tiles, true);
  rest.list.items = 0;
  for (int b = 0; b < p.list.count; ++b) {
    rest.list.first[b] = rest.list.items;
    rest.list.items += int(ceil_div(tiles_of(b), int64_t(chunk)));
  }
  scatter_covered_list<T><<<unsigned(rest.list.items), kThreads, 0, stream>>>(rest, chunk);
  return cudaGetLastError();
}

template <class T>
int sample_antialiased_list_matrix_backward(AntialiasedListMatrixBackward<T> const& p, CUstream_st* stream) {
  int const bytes = differentiate_bytes<T>(p.all.x.channels);
  differentiate_covered_list<T><<<unsigned(p.list.items), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_antialiased_list_backward, SampleListBackward)
KV_INSTANTIATE(sample_antialiased_list_matrix_backward, AntialiasedListMatrixBackward)

}  // namespace kv::geometry::cuda
