// The strip kernel of separable_strip.cuh for float.
#include "separable_strip.cuh"

namespace kv::cuda {

template <>
int separable_strips(Separable<float> const& p, CUstream_st* stream) {
  launch_strip_of_size(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
