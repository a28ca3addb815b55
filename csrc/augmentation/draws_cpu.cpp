// Random parameters on the CPU: samples [begin, end). Compiled once per instruction set.
#include "augmentation/draws.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void draw_parameters(DrawParameters<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b)
    for (int i = 0; i < p.count; ++i) draw_sample(p, p.draws[i], b);
}

template <class T>
void draw_list_parameters(DrawListParameters<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i)
    for (int j = 0; j < p.all.count; ++j) draw_sample(p, p.all.draws[j], i);
}

KV_INSTANTIATE_ONE(draw_parameters, DrawParameters, float)
KV_INSTANTIATE_ONE(draw_list_parameters, DrawListParameters, float)

}  // namespace kv::augmentation::KV_ISA
