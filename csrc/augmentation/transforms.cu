// Matrices of chains of transforms on CUDA: a thread for each sample, and for each column of each sample in the
// gradient.
#include "augmentation/transforms.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kTransformThreads = 64;

template <class T>
__device__ __forceinline__ double transform_input(TransformMatrix<T> const& p, int64_t b, int column, double number) {
  return column < 0 ? number : double(read(p.parameters[b * p.stride + column * p.column_stride]));
}

template <class T>
__global__ void __launch_bounds__(kTransformThreads) multiply_chains(__grid_constant__ TransformMatrix<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kTransformThreads) + threadIdx.x;
  if (b >= p.batch) return;
  double m[9];
  evaluate_chain(p, m, [&](int column, double number) { return transform_input(p, b, column, number); });
  for (int i = 0; i < 9; ++i) p.result[9 * b + i] = round_to<T>(Compute<T>(m[i]));
}

template <class T>
__global__ void __launch_bounds__(kTransformThreads)
    differentiate_chains(__grid_constant__ TransformMatrix<T> const p) {
  int64_t const i = blockIdx.x * int64_t(kTransformThreads) + threadIdx.x, b = i / p.columns;
  if (b >= p.batch) return;
  int const seeded = int(i - b * p.columns);
  Dual<double, 1> m[9];
  evaluate_chain(p, m, [&](int column, double number) {
    return Dual<double, 1>{transform_input(p, b, column, number), {double(column == seeded)}};
  });
  double sum = 0;
  for (int k = 0; k < 9; ++k) sum += double(read(p.grad[9 * b + k])) * m[k].d[0];
  p.grad_parameters[i] = round_to<T>(Compute<T>(sum));
}

}  // namespace

template <class T>
int transform_matrix(TransformMatrix<T> const& p, CUstream_st* stream) {
  multiply_chains<<<unsigned(ceil_div(p.batch, kTransformThreads)), kTransformThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int transform_matrix_backward(TransformMatrix<T> const& p, CUstream_st* stream) {
  differentiate_chains<<<unsigned(ceil_div(p.batch * p.columns, kTransformThreads)), kTransformThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(transform_matrix, TransformMatrix)
KV_INSTANTIATE(transform_matrix_backward, TransformMatrix)

}  // namespace kv::augmentation::cuda
