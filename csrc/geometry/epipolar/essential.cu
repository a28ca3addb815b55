// Essential matrices on CUDA: one thread for each matrix, one block where the kernel reads points, too.
#include "core/launch.cuh"
#include "geometry/epipolar/essential.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 64;

template <class T>
__global__ void __launch_bounds__(kThreads) decompose_all(__grid_constant__ Essential<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) decompose_essential(p, b);
}

template <class T>
__global__ void __launch_bounds__(kThreads) decompose_all_vjp(__grid_constant__ Essential<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) essential_vjp(p, b);
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) choose_motions(__grid_constant__ MotionChoice<T> const p) {
  choose_motion(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int essential(Essential<T> const& p, CUstream_st* stream) {
  decompose_all<T><<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int essential_backward(Essential<T> const& p, CUstream_st* stream) {
  decompose_all_vjp<T><<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int motion_choice(MotionChoice<T> const& p, CUstream_st* stream) {
  choose_motions<T><<<unsigned(p.batch), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(essential, Essential, double)
KV_INSTANTIATE_ONE(essential_backward, Essential, double)
KV_INSTANTIATE_ONE(motion_choice, MotionChoice, double)

}  // namespace kv::geometry::cuda
