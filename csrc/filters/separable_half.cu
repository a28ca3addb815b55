// The strip kernel of separable_strip.cuh for Half.
#include "separable_strip.cuh"

namespace kv::cuda {

template <>
int separable_strips(Separable<Half> const& p, CUstream_st* stream) {
  launch_strip_of_size(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
