// The strip kernel of separable_strip.cuh for uint8_t.
#include "separable_strip.cuh"

namespace kv::cuda {

template <>
int separable_strips(Separable<uint8_t> const& p, CUstream_st* stream) {
  launch_strip_of_size(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
