// Random parameters on the CPU: samples [begin, end). Compiled once per instruction set.
#include "augmentation/draws.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void draw_parameters(DrawParameters<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b)
    for (int i = 0; i < p.count; ++i) draw_sample(p, p.draws[i], b);
}

KV_INSTANTIATE_ONE(draw_parameters, DrawParameters, float)

}  // namespace kv::augmentation::KV_ISA
