// How libkvision_cuda.so was built, and messages for CUDA's errors.
#include <cuda_runtime.h>

namespace kv {
char const* cuda_error_string(int error) { return cudaGetErrorString(static_cast<cudaError_t>(error)); }
}  // namespace kv

#define KV_EXPORT extern "C" __attribute__((visibility("default")))

KV_EXPORT char const* kvision_cuda_architectures() { return KV_CUDA_ARCHITECTURES; }
KV_EXPORT int kvision_cuda_runtime() { return CUDART_VERSION; }
