// The kernel of separable_fold.cuh, for BFloat16.
#include "separable_fold.cuh"

namespace kv::cuda {

template <>
int separable_folds(Separable<BFloat16> const& p, CUstream_st* stream) {
  launch_fold_of_size<BFloat16>(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
