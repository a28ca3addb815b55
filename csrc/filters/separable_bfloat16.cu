// The strip kernel of separable_strip.cuh for BFloat16.
#include "separable_strip.cuh"

namespace kv::cuda {

template <>
int separable_strips(Separable<BFloat16> const& p, CUstream_st* stream) {
  launch_strip_of_size(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
