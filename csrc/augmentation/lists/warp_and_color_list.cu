// Warps of lists of images of different sizes with a program of color steps, on CUDA.
#include "augmentation/warp_blocks/warp_rows.cuh"

namespace kv::augmentation::cuda {

static_assert(sizeof(WarpAndColorList<float>) <= 32764, "more than a kernel's parameters");

template <class T>
int warp_and_color_list(WarpAndColorList<T> const& p, CUstream_st* stream) {
  return launch_warp_rows<ListSource<T>>(p, p.count, stream);
}

KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, float)
KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, uint8_t)
KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, ::kv::Half)
KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, ::kv::BFloat16)

}  // namespace kv::augmentation::cuda
