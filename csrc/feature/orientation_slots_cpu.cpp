// Slots of orientations on the CPU: samples [begin, end). Compiled once per instruction set.
#include "orientation_slots.h"

namespace kv::feature::KV_ISA {

template <class F>
void orientation_slots(OrientationSlots<F> const& p, int64_t begin, int64_t end) {
  for (int64_t sample = begin; sample < end; ++sample) {
    int64_t slot = 0;
    for (int64_t i = sample * p.count; i < (sample + 1) * p.count && slot < p.count; ++i) {
      int const orientations = p.count_orientations(i);
      if (orientations > 0) p.store(sample, slot, i);
      slot += orientations;
    }
    for (; slot < p.count; ++slot) p.clear(sample, slot);
  }
}

KV_INSTANTIATE_COMPUTED(orientation_slots, OrientationSlots)

}  // namespace kv::feature::KV_ISA
