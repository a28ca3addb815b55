// The contributors of an element and their weights on CUDA, for tables and for kernels of any type and size. Included
// by resize.cu, resize_windows.cuh and lists/resize_list.cu.
#pragma once

#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

// Not inline, as they take most of the time to compile.
template <class F>
__device__ __noinline__ Contributors<F> find_contributors(ResizeAxis const& axis, int index) {
  return contributors<F>(axis, index);
}
template <class F>
__device__ __noinline__ F find_weight(ResizeAxis const& axis, Contributors<F> const reads, int index, int k) {
  return weight_at(axis, reads, index, k);
}

}  // namespace
}  // namespace kv::geometry::cuda
