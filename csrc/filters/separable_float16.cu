// The strip kernel of separable_strip.cuh, for Half.
#include "separable_strip.cuh"

namespace kv::filters::cuda {

template <>
int separable_strips(Separable<Half> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<Half, false>(p, divisor, stream);
}

}  // namespace kv::filters::cuda
