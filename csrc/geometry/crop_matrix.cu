// Matrices of crops on CUDA, a thread a sample.
#include "core/launch.cuh"
#include "crop_matrix.h"

namespace kv::cuda {
namespace {

template <class F>
__global__ void write_crop_matrices(CropMatrix<F> p) {
  int64_t const b = int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  if (b < p.batch) write_crop_matrix(p, b);
}

}  // namespace

template <class F>
int crop_matrix(CropMatrix<F> const& p, CUstream_st* stream) {
  write_crop_matrices<<<unsigned(ceil_div(p.batch, 64)), 64, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(crop_matrix, CropMatrix)

}  // namespace kv::cuda
