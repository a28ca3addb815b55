// Numbers of the tensors of a list, of any sizes, by one launch on CUDA.
#pragma once

#include "core/half.h"
#include "core/image_list.h"
#include "core/isa.h"

namespace kv::geometry {

// Dense tensors that are written: with zeros, or rounded from those that are computed in.
template <class T>
struct ListedNumbers {
  int count;
  Compute<T> const* from[kMaxListed];  // or null for zeros
  T* to[kMaxListed];
  int64_t numbers[kMaxListed];
};

// On CUDA only.
KV_KERNEL(write_numbers, ListedNumbers)

}  // namespace kv::geometry
