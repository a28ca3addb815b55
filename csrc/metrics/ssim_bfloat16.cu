// The kernels of ssim_strip.cuh, for BFloat16.
#include "ssim_strip.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(ssim, Ssim, BFloat16)
KV_INSTANTIATE_ONE(ssim_backward, SsimBackward, BFloat16)

}  // namespace kv::cuda
