// Shuffled channels on CUDA: a block has some pixels of a result.
#include "augmentation/lists/shuffle_channels.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kShuffleThreads = 256;

template <class T>
__global__ void __launch_bounds__(kShuffleThreads) shuffle(__grid_constant__ ShuffleChannels<T> const p) {
  int const b = p.list.sample_of(int(blockIdx.x));
  p.copy(b, blockIdx.x - unsigned(p.list.first[b]), threadIdx.x, kShuffleThreads);
}

}  // namespace

template <class T>
int shuffle_channels_list(ShuffleChannels<T> const& p, CUstream_st* stream) {
  shuffle<<<unsigned(p.list.items), kShuffleThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint8_t)
KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint16_t)
KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint32_t)
KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint64_t)

}  // namespace kv::augmentation::cuda
