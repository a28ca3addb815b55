// A number, expanded to all pixels of a tensor, on CUDA. Included by expand.cu and warp_and_color_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv::augmentation {

template <class T>
struct ExpandNumber {
  T const* number;
  T* result;  // dense, aligned to 16 bytes
  int64_t count;
};

KV_KERNEL(expand_number, ExpandNumber)

}  // namespace kv::augmentation
