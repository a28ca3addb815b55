// The shared memory of a block, in a file of its own: operators, which nvcc does not compile, call it as well.
#include <cuda_runtime_api.h>

#include <cstdlib>

#include "shared_memory.h"

namespace kv {

int64_t max_shared_bytes(int64_t most) {
  static int64_t const limit = [] {
    char const* const text = getenv("KVISION_SHARED_MEMORY");
    return text && *text ? strtoll(text, nullptr, 10) : INT64_MAX;
  }();
  int device = 0, bytes = 48 << 10;
  cudaGetDevice(&device);
  cudaDeviceGetAttribute(&bytes, cudaDevAttrMaxSharedMemoryPerBlockOptin, device);
  return min(most, min(limit, int64_t(bytes)));
}

}  // namespace kv
