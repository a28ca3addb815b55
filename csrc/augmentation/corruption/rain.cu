// Lines of rain on CUDA: a thread for each drop, whose pixels it sets to 1, as others do that cross it.
#include "augmentation/corruption/rain.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kRainThreads = 128;

template <class Params>
__global__ void __launch_bounds__(kRainThreads) mark_drops(__grid_constant__ Params const p) {
  auto const one = p.sample(blockIdx.y);
  int64_t const n = int64_t(blockIdx.x) * kRainThreads + threadIdx.x;
  Rain const rain(one);
  if (n < rain.count) rain.mark(one.positions + 2 * n, one.y);
}

template <class Params, class T>
int launch_drops(Params const& p, RainMask<T> const& all, CUstream_st* stream) {
  cudaError_t const error = cudaMemsetAsync(all.y, 0, size_t(all.batch * all.tall * all.wide), stream);
  if (error != cudaSuccess || all.most == 0) return error;
  dim3 const blocks(unsigned(ceil_div(all.most, int64_t(kRainThreads))), unsigned(all.batch));
  mark_drops<<<blocks, kRainThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int rain_mask(RainMask<T> const& p, CUstream_st* stream) {
  return launch_drops(p, p, stream);
}
template <class T>
int rain_mask_list(RainMaskList<T> const& p, CUstream_st* stream) {
  return launch_drops(p, p.all, stream);
}

KV_INSTANTIATE_ONE(rain_mask, RainMask, float)
KV_INSTANTIATE_ONE(rain_mask_list, RainMaskList, float)

}  // namespace kv::augmentation::cuda
