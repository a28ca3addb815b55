// The kernel of separable_fold.cuh, for Half.
#include "separable_fold.cuh"

namespace kv::cuda {

template <>
int separable_folds(Separable<Half> const& p, CUstream_st* stream) {
  launch_fold_of_size<Half>(p, stream);
  return cudaGetLastError();
}

}  // namespace kv::cuda
