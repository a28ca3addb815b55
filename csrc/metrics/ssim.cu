// The kernels of ssim_strip.cuh, for float; double has no kernel on CUDA.
#include "ssim_strip.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(ssim, Ssim, float)
KV_INSTANTIATE_ONE(ssim_backward, SsimBackward, float)
KV_INSTANTIATE_ONE(ssim, Ssim, double)
KV_INSTANTIATE_ONE(ssim_backward, SsimBackward, double)

}  // namespace kv::cuda
