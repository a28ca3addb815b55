// The kernels of ssim_strip.cuh, for Half.
#include "ssim_strip.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(ssim, Ssim, Half)
KV_INSTANTIATE_ONE(ssim_backward, SsimBackward, Half)

}  // namespace kv::cuda
