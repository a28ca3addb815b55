// Numbers of masks on CUDA: some blocks for each image.
#include "augmentation/occlusion/mask_numbers.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kMaskThreads = 256, kMasksOfThread = 8;

template <class T>
__global__ void __launch_bounds__(kMaskThreads) number_of_masks(__grid_constant__ MaskNumbers<T> const p) {
  int const b = int(blockIdx.y);
  int64_t const first = blockIdx.x * int64_t(kMaskThreads) + threadIdx.x, step = int64_t(gridDim.x) * kMaskThreads;
  if (first == 0) p.widths[b] = p.masks[b].width;
  for (int64_t i = first; i < p.pixels(); i += step) p.write(b, i);
}

}  // namespace

template <class T>
int number_masks(MaskNumbers<T> const& p, CUstream_st* stream) {
  int64_t const blocks = ceil_div(p.pixels(), int64_t(kMaskThreads * kMasksOfThread));
  number_of_masks<T><<<dim3(unsigned(min(blocks, int64_t(1) << 20)), unsigned(p.count)), kMaskThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(number_masks, MaskNumbers, int64_t)

}  // namespace kv::augmentation::cuda
