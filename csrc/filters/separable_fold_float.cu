// The kernel of separable_fold.cuh, for float.
#include "separable_fold.cuh"

namespace kv::cuda {

template <>
int separable_folds(Separable<float> const& p, CUstream_st* stream) {
  launch_fold_of_size<float>(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
