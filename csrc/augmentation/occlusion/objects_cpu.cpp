// Dropped objects on the CPU: samples [begin, end). Compiled once per instruction set.
#include "augmentation/occlusion/objects.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void drop_objects(DropObjects<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    auto const rank_of = p.ranks(b);
    int64_t lowest = p.kNone, size = p.masks * p.pixels;
    for (int k = 0; k < p.count(b); ++k) {
      int64_t best = -1;
      for (int64_t i = 0; i < size; ++i) {
        int64_t const rank = rank_of(i);
        if (rank < lowest) best = max(best, rank);
      }
      if (best < 0) break;
      lowest = best;
    }
    uint8_t* const y = p.y + b * p.pixels;
    for (int64_t i = 0; i < p.pixels; ++i) y[i] = 0;
    for (int64_t i = 0; i < size; ++i) y[i % p.pixels] |= rank_of(i) >= lowest;
  }
}

KV_INSTANTIATE_ONE(drop_objects, DropObjects, int64_t)

}  // namespace kv::augmentation::KV_ISA
