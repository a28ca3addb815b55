// The strip kernel of separable_strip.cuh, for float.
#include "separable_strip.cuh"

namespace kv::filters::cuda {

template <>
int separable_strips(Separable<float> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<float, false>(p, divisor, stream);
}
template <>
int separable_strips(SeparableList<float> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<float, false>(p, divisor, stream);
}

}  // namespace kv::filters::cuda
