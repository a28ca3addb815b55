// The kernels of motion blur on CUDA: one block for each kernel.
#include "core/block_reduce.cuh"
#include "motion.h"

namespace kv::filters::cuda {
namespace {

constexpr int kThreads = 128;

template <class T>
__global__ void __launch_bounds__(kThreads) motion_kernels(__grid_constant__ MotionKernel<T> const p) {
  __shared__ double warp_sums[kThreads / 32];
  MotionLine const line = motion_line(p, blockIdx.x, [](T x) { return read(x); });
  int64_t const count = p.count();
  T* const to = p.kernels + blockIdx.x * count;
  double sum = 0;
  for (int64_t i = threadIdx.x; i < count; i += kThreads) sum += line.weight(i);
  sum = block_sum_to_all(sum, warp_sums);
  for (int64_t i = threadIdx.x; i < count; i += kThreads) to[i] = round_to<T>(Compute<T>(line.weight(i) / sum));
}

}  // namespace

template <class T>
int motion_kernel(MotionKernel<T> const& p, CUstream_st* stream) {
  motion_kernels<<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(motion_kernel, MotionKernel)

}  // namespace kv::filters::cuda
