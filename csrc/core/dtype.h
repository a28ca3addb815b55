// Storage types that are known at run time only. Included by kernels that are compiled once for all of them.
#pragma once

#include "half.h"

namespace kv {

// The numbers are stable: color programs in exported graphs contain them.
enum class DType : int { uint8, float16, bfloat16, float32, float64 };

template <class T>
constexpr DType kDType = sizeof(T) == 8       ? DType::float64
                         : sizeof(T) == 4     ? DType::float32
                         : sizeof(T) == 1     ? DType::uint8
                         : __is_same(T, Half) ? DType::float16
                                              : DType::bfloat16;

// The size of an element in bytes.
KV_HD int size_of(DType dtype) {
  return dtype == DType::uint8 ? 1 : dtype == DType::float64 ? 8 : dtype == DType::float32 ? 4 : 2;
}

// Calls f with a value of the type.
template <class F>
KV_HD void dispatch_dtype(DType dtype, F f) {
  switch (dtype) {
    case DType::uint8:
      return f(uint8_t{});
    case DType::float16:
      return f(Half{});
    case DType::bfloat16:
      return f(BFloat16{});
    case DType::float32:
      return f(float{});
    case DType::float64:
      return f(double{});
  }
}

}  // namespace kv
