// Lines of rain on the CPU: samples [begin, end). Compiled once per instruction set.
#include "augmentation/corruption/rain.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void rain_mask(RainMask<T> const& p, int64_t begin, int64_t end) {
  int64_t const pixels = p.height * p.width;
  for (int64_t b = begin; b < end; ++b) {
    Rain const rain(p, b);
    uint8_t* const y = p.y + b * pixels;
    for (int64_t i = 0; i < pixels; ++i) y[i] = 0;
    for (int64_t n = 0; n < rain.count; ++n) rain.mark(p.positions + 2 * (b * p.most + n), y);
  }
}

KV_INSTANTIATE_ONE(rain_mask, RainMask, float)

}  // namespace kv::augmentation::KV_ISA
