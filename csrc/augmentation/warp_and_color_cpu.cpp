// Warps of a batch with a program of color steps on the CPU. Compiled once per instruction set.
#include "augmentation/warp_blocks/warp_bands.h"

namespace kv::augmentation::KV_ISA {
template <class T>
void warp_and_color(WarpAndColor<T> const& p, int64_t begin, int64_t end) {
  warp_bands(p, begin, end, [&](int64_t) -> geometry::Sample<T> const& { return p.warp; });
}

KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, float)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, uint8_t)
#if !defined(__AVX512F__)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, ::kv::Half)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, ::kv::BFloat16)
#endif

}  // namespace kv::augmentation::KV_ISA
