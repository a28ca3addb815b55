// Lines of rain on CUDA: a thread for each drop, whose pixels it sets to 1, as others do that cross it.
#include "augmentation/corruption/rain.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kRainThreads = 128;

template <class T>
__global__ void __launch_bounds__(kRainThreads) mark_drops(__grid_constant__ RainMask<T> const p) {
  int64_t const b = blockIdx.y, n = int64_t(blockIdx.x) * kRainThreads + threadIdx.x;
  Rain const rain(p, b);
  if (n < rain.count) rain.mark(p.positions + 2 * (b * p.most + n), p.y + b * p.height * p.width);
}

}  // namespace

template <class T>
int rain_mask(RainMask<T> const& p, CUstream_st* stream) {
  cudaError_t const error = cudaMemsetAsync(p.y, 0, size_t(p.batch * p.height * p.width), stream);
  if (error != cudaSuccess || p.most == 0) return error;
  mark_drops<<<dim3(unsigned(ceil_div(p.most, int64_t(kRainThreads))), unsigned(p.batch)), kRainThreads, 0, stream>>>(
      p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(rain_mask, RainMask, float)

}  // namespace kv::augmentation::cuda
