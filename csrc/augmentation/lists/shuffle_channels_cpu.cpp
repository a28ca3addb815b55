// Shuffled channels on the CPU: items [begin, end). Compiled once per instruction set.
#include "augmentation/lists/shuffle_channels.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void shuffle_channels_list(ShuffleChannels<T> const& p, int64_t begin, int64_t end) {
  for (int64_t item = begin; item < end; ++item) {
    int const b = p.list.sample_of(int(item));
    p.copy(b, uint32_t(item - p.list.first[b]), 0, 1);
  }
}

KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint8_t)
KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint16_t)
KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint32_t)
KV_INSTANTIATE_ONE(shuffle_channels_list, ShuffleChannels, uint64_t)

}  // namespace kv::augmentation::KV_ISA
