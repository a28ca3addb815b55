// The kernel of separable_fold.cuh, for the types that have gradients.
#include "separable_fold.cuh"

namespace kv::cuda {

template <class T>
int separable_folds(Separable<T> const& p, CUstream_st* stream) {
  launch_fold_of_size(p, stream);
  return cudaGetLastError();
}

template int separable_folds(Separable<float> const&, CUstream_st*);
template int separable_folds(Separable<Half> const&, CUstream_st*);
template int separable_folds(Separable<BFloat16> const&, CUstream_st*);

}  // namespace kv::cuda
