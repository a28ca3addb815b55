// How pixels are stored, found out when a kernel runs: for kernels of which reading and writing them is little of the
// work, and that would take long to compile for each type. Included by *.cu files.
#pragma once

#include "launch.cuh"

namespace kv::cuda {

enum class Stored : int { floats, halves, bfloats, doubles };
template <class T>
constexpr Stored kStored = sizeof(T) == 8       ? Stored::doubles
                           : sizeof(T) == 4     ? Stored::floats
                           : __is_same(T, Half) ? Stored::halves
                                                : Stored::bfloats;

// Calls f with a value of the type that pixels are stored in; F is what they are computed in.
template <class F = float, class Call>
__device__ __forceinline__ void with_type(Stored stored, Call f) {
  if constexpr (sizeof(F) == 8)
    f(double{});
  else if (stored == Stored::floats)
    f(float{});
  else if (stored == Stored::halves)
    f(Half{});
  else
    f(BFloat16{});
}

}  // namespace kv::cuda
