// Essential matrices on CUDA: a thread a matrix; a block where its points are looked at, too.
#include "core/launch.cuh"
#include "geometry/epipolar/essential.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 64;

template <class T>
__global__ void __launch_bounds__(kThreads) take_apart(__grid_constant__ Essential<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) essential_of(p, b);
}

template <class T>
__global__ void __launch_bounds__(kThreads) take_apart_backward(__grid_constant__ Essential<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (b < p.batch) essential_vjp(p, b);
}

template <class T>
__global__ void __launch_bounds__(kMostThreads) choose_motions(__grid_constant__ MotionChoice<T> const p) {
  motion_choice_of(p, blockIdx.x, Block{});
}

}  // namespace

template <class T>
int essential(Essential<T> const& p, CUstream_st* stream) {
  take_apart<T><<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int essential_backward(Essential<T> const& p, CUstream_st* stream) {
  take_apart_backward<T><<<unsigned(ceil_div(p.batch, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int motion_choice(MotionChoice<T> const& p, CUstream_st* stream) {
  choose_motions<T><<<unsigned(p.batch), team_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(essential, Essential, double)
KV_INSTANTIATE_ONE(essential_backward, Essential, double)
KV_INSTANTIATE_ONE(motion_choice, MotionChoice, double)

}  // namespace kv::cuda
