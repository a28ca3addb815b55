// Floating-point storage types that are known at run time only, on CUDA: for kernels that spend little of their work on
// reading and writing pixels, and that would take long to compile for each type. Included by *.cu files.
#pragma once

#include "dtype.h"
#include "launch.cuh"

namespace kv {

// Calls f with a value of the storage type. F is the compute type: double is stored as double alone.
template <class F = float, class Call>
__device__ __forceinline__ void dispatch_floating_dtype(DType dtype, Call f) {
  if constexpr (sizeof(F) == 8)
    f(double{});
  else if (dtype == DType::float32)
    f(float{});
  else if (dtype == DType::float16)
    f(Half{});
  else
    f(BFloat16{});
}

}  // namespace kv
