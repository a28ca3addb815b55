// Numbers that become constants of a kernel's code, on CUDA. Included by *.cu files.
#pragma once

#include <type_traits>

namespace kv {
namespace {

// Calls f with i, which is the same in all threads of a warp and in [0, N), as a constant.
template <int N, int Begin = 0, class F>
__device__ __forceinline__ void with_constant(int i, F f) {
  if constexpr (N == 1)
    f(std::integral_constant<int, Begin>{});
  else if (i < Begin + N / 2)
    with_constant<N / 2, Begin>(i, f);
  else
    with_constant<N - N / 2, Begin + N / 2>(i, f);
}

}  // namespace
}  // namespace kv
