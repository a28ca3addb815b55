// Fills a tensor with a number in device memory, on CUDA.
#pragma once

#include "core/isa.h"

namespace kv::augmentation {

template <class T>
struct BroadcastScalar {
  T const* scalar;
  T* result;  // dense, aligned to 16 bytes
  int64_t count;
};

KV_KERNEL(broadcast_scalar, BroadcastScalar)

}  // namespace kv::augmentation
