// The operations of policies on lists of images of different sizes on CUDA, in the launches of a batch: all planes have
// as many blocks, and a block of tiles finds its sample in the table.
#include "augmentation/auto/operations.cuh"
#include "geometry/transform/lists/list_block.cuh"

namespace kv::augmentation::cuda {
namespace {

template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    measure_listed_planes(__grid_constant__ ApplyOperationsList<T> const p, unsigned parts) {
  unsigned const plane = blockIdx.x / parts;
  int const channels = p.all.channels(), b = int(plane) / channels, channel = int(plane) - b * channels;
  Images<T const> const x = images_of<T>(p.list.images[b], channels);
  measure_plane<P>(p.all, x, b, 0, channel, blockIdx.x - plane * parts, parts);
}

template <class T, int C>
__global__ void __launch_bounds__(kThreads, 4) apply_to_listed_tiles(__grid_constant__ ApplyOperationsList<T> const p) {
  using Block = geometry::cuda::ListBlock<ApplyOperations<T>>;
  __shared__ __align__(16) unsigned char memory[sizeof(Block)];
  Block const& block = Block::make(memory, p, p.tiles_per_block, [](ApplyOperations<T> const& one) -> geometry::Size {
    return {one.warp.y.height, one.warp.y.width};
  });
  bool const vectors = has_vectors(block.sample.warp.x) && has_vectors(block.sample.warp.y);
  geometry::cuda::Tile<float> first;
  first.locate(block.tiles, 0);
  int const columns = int(block.sample.warp.y.width) - first.x;
  for (int number = 0; number < p.tiles_per_block && number * kTile < columns; ++number) {
    apply_to_tile<C>(block.sample, block.tiles, number, vectors);
    __syncthreads();  // which also keeps what the tiles share out of registers
  }
}

constexpr int kMixThreads = 256;

template <class T>
__global__ void __launch_bounds__(kMixThreads) mix_chain(__grid_constant__ MixOperations<T> const p) {
  int const b = p.list.sample_of(int(blockIdx.x));
  T const* const image = static_cast<T const*>(p.list.images[b].data);
  T* const result = static_cast<T*>(p.list.results[b].data);
  int64_t const begin = p.begin_of(b), first = (int64_t(blockIdx.x) - p.list.first[b]) * kMixedValues,
                last = min(first + kMixedValues, p.values_of(b));
#pragma unroll 4
  for (int64_t i = first + threadIdx.x; i < last; i += kMixThreads) {
    float const own = p.is_first ? read(image[i]) : 0, before = p.is_first ? 0 : p.sums[begin + i];
    float const sum = p.sum(b, own, read(p.chains[begin + i]), before);
    if (p.is_last)
      result[i] = round_to<T>(sum);
    else
      p.sums[begin + i] = sum;
  }
}

}  // namespace

template <class T>
int mix_operations_list(MixOperations<T> const& p, CUstream_st* stream) {
  mix_chain<<<unsigned(p.list.items), kMixThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int apply_operations_list(ApplyOperationsList<T> const& p, CUstream_st* stream) {
  int64_t most = 0;
  for (int b = 0; b < p.list.count; ++b) most = max(most, p.list.images[b].height * int64_t(p.list.images[b].width));
  auto* const measure =
      p.list.interleaved ? measure_listed_planes<T, 1> : measure_listed_planes<T, enhance::kRowVector<T>>;
  unsigned const parts = unsigned(parts_of_planes(measure, most)), blocks = unsigned(p.list.count * p.all.channels());
  if (int const error = launch_clusters(measure, blocks * parts, kThreads, 0, parts, stream, p, parts)) return error;
  auto* const apply = p.all.channels() == kColors ? apply_to_listed_tiles<T, kColors> : apply_to_listed_tiles<T, 1>;
  apply<<<unsigned(p.list.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, float)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, float)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, uint8_t)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, uint8_t)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, ::kv::Half)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, ::kv::BFloat16)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, ::kv::BFloat16)

}  // namespace kv::augmentation::cuda
