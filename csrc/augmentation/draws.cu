// Random parameters on CUDA: one thread for each draw of each sample. The threads of a block have the same draw.
#include "augmentation/draws.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kDrawThreads = 64;

template <class T>
__global__ void __launch_bounds__(kDrawThreads) draw_all(__grid_constant__ DrawParameters<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kDrawThreads) + threadIdx.x;
  if (b < p.batch) draw_sample(p, p.draws[blockIdx.y], b);
}

static_assert(sizeof(DrawListParameters<float>) <= 32764, "more than a kernel's parameters");

template <class Draws>
__global__ void __launch_bounds__(kDrawThreads) draw_listed(__grid_constant__ Draws const p) {
  int const i = blockIdx.x * kDrawThreads + threadIdx.x;
  if (i < p.count) draw_sample(p, p.all.draws[blockIdx.y], i);
}

template <class Draws>
int launch_listed(Draws const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.count, kDrawThreads)), unsigned(p.all.count));
  draw_listed<<<blocks, kDrawThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int draw_parameters(DrawParameters<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.batch, kDrawThreads)), unsigned(p.count));
  draw_all<<<blocks, kDrawThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int draw_list_parameters(DrawListParameters<T> const& p, CUstream_st* stream) {
  return launch_listed(p, stream);
}
template <class T>
int draw_list_parameters(DrawListParameters<T, kFewListedNumbers> const& p, CUstream_st* stream) {
  return launch_listed(p, stream);
}

KV_INSTANTIATE_ONE(draw_parameters, DrawParameters, float)
KV_INSTANTIATE_ONE(draw_list_parameters, DrawListParameters, float)
template int draw_list_parameters(DrawListParameters<float, kFewListedNumbers> const&, CUstream_st*);

}  // namespace kv::augmentation::cuda
