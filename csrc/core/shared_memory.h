// How much shared memory the current GPU gives a block. Where it is less than what kernels were tuned for, they take
// smaller tiles, or other kernels serve the call.
#pragma once

#include "hd.h"

namespace kv {

// In bytes: 227 KiB for compute capabilities 9.0 and 10.0, 163 for 8.0, 99 for 8.6, 8.9 and 12.0, 64 for 7.5.
// KVISION_SHARED_MEMORY in the environment lowers it, so that any GPU can test what smaller ones run.
// The result is at most `most`, for kernels that use no more.
int64_t max_shared_bytes(int64_t most = INT64_MAX);

}  // namespace kv
