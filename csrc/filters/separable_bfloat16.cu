// The strip kernel of separable_strip.cuh, for BFloat16.
#include "separable_strip.cuh"

namespace kv::filters::cuda {

template <>
int separable_strips(Separable<BFloat16> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<BFloat16, false>(p, divisor, stream);
}

}  // namespace kv::filters::cuda
