// Lines of rain on the CPU: samples [begin, end). Compiled once per instruction set.
#include "augmentation/corruption/rain.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

namespace {

template <class Params>
KV_HD void mark_samples(Params const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    auto const one = p.sample(b);
    Rain const rain(one);
    for (int64_t i = 0; i < one.tall * one.wide; ++i) one.y[i] = 0;
    for (int64_t n = 0; n < rain.count; ++n) rain.mark(one.positions + 2 * n, one.y);
  }
}

}  // namespace

template <class T>
void rain_mask(RainMask<T> const& p, int64_t begin, int64_t end) {
  mark_samples(p, begin, end);
}
template <class T>
void rain_mask_list(RainMaskList<T> const& p, int64_t begin, int64_t end) {
  mark_samples(p, begin, end);
}

KV_INSTANTIATE_ONE(rain_mask, RainMask, float)
KV_INSTANTIATE_ONE(rain_mask_list, RainMaskList, float)

}  // namespace kv::augmentation::KV_ISA
