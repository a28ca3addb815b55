// The kernels of separable_strip.cuh and separable_groups.cuh, for bytes.
#include "separable_groups.cuh"

namespace kv::filters::cuda {

template <>
int separable_strips(Separable<uint8_t> const& p, float divisor, CUstream_st* stream) {
  return launch_strips_or_groups(p, divisor, stream);
}
template <>
int separable_strips(SeparableList<uint8_t> const& p, float divisor, CUstream_st* stream) {
  return launch_strips_or_groups(p, divisor, stream);
}

}  // namespace kv::filters::cuda
