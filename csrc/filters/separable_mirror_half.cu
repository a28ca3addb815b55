// The mirrored strip kernel of separable_strip.cuh, for Half.
#include "separable_strip.cuh"

namespace kv::cuda {

template <>
int separable_mirrors(Separable<Half> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<Half, true>(p, divisor, stream);
}

}  // namespace kv::cuda
