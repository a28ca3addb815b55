// The strip kernel of separable_strip.cuh, for uint8_t.
#include "separable_strip.cuh"

namespace kv::filters::cuda {

template <>
int separable_strips(Separable<uint8_t> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<uint8_t, false>(p, divisor, stream);
}

}  // namespace kv::filters::cuda
