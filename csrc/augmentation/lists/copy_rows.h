// Rows of tensors, each all numbers of one sample, as one tensor.
#pragma once

#include "core/isa.h"

namespace kv::augmentation {

constexpr int kCopiedRows = 256;  // at a time: a table of this size fits the parameters of a CUDA kernel

// T are bytes.
template <class T>
struct CopyRows {
  T const* from[kCopiedRows];
  T* to;
  int64_t size;  // of a row
  int count;
};

KV_KERNEL(copy_rows, CopyRows)

}  // namespace kv::augmentation
