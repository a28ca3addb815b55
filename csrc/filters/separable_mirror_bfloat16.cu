// The mirrored strip kernel of separable_strip.cuh, for BFloat16.
#include "separable_strip.cuh"

namespace kv::cuda {

template <>
int separable_mirrors(Separable<BFloat16> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<BFloat16, true>(p, divisor, stream);
}

}  // namespace kv::cuda
