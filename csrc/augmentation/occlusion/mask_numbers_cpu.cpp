// Numbers of masks on the CPU: images [begin, end). Compiled once per instruction set.
#include "augmentation/occlusion/mask_numbers.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void number_masks(MaskNumbers<T> const& p, int64_t begin, int64_t end) {
  for (int b = int(begin); b < int(end); ++b) {
    p.widths[b] = p.masks[b].width;
    for (int64_t i = 0; i < p.pixels(); ++i) p.write(b, i);
  }
}

KV_INSTANTIATE_ONE(number_masks, MaskNumbers, int64_t)

}  // namespace kv::augmentation::KV_ISA
