// Reductions over the threads of a warp.
#pragma once

#include <cuda_runtime.h>

#include "hd.h"

namespace kv {

// Operations for warp_reduce and block_reduce. Min and Max are those of hd.h: threads may get different results if one
// has NaN.
struct Sum {
  template <class F>
  __device__ __forceinline__ F operator()(F a, F b) const {
    return a + b;
  }
};
struct Min {
  template <class F>
  __device__ __forceinline__ F operator()(F a, F b) const {
    return min(a, b);
  }
};
struct Max {
  template <class F>
  __device__ __forceinline__ F operator()(F a, F b) const {
    return max(a, b);
  }
};

// The value of the thread whose lane differs in the bits of `lanes`: a number, or a struct of numbers.
template <class V>
__device__ __forceinline__ V shuffle_xor(V const& x, int lanes) {
  if constexpr (!__is_class(V)) {
    return __shfl_xor_sync(0xffffffffu, x, lanes);
  } else {
    static_assert(__is_trivially_copyable(V) && sizeof(V) % sizeof(int) == 0);
    V other;  // not by memcpy, which takes more instructions in feature/matching.cu
#pragma unroll
    for (int i = 0; i < int(sizeof(V) / sizeof(int)); ++i)
      reinterpret_cast<int*>(&other)[i] = __shfl_xor_sync(0xffffffffu, reinterpret_cast<int const*>(&x)[i], lanes);
    return other;
  }
}

// Combines the values of N adjacent threads of a warp by `op`, which is commutative; all of them get the result. With
// Stride > 1, only the values of threads whose lanes are equal modulo Stride are combined.
template <int N = 32, int Stride = 1, class V, class Op>
__device__ __forceinline__ V warp_reduce(V x, Op op) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  constexpr bool kOneInstruction = N == 32 && Stride == 1 && __is_same(V, int);
  if constexpr (kOneInstruction && __is_same(Op, Sum))
    return __reduce_add_sync(0xffffffffu, x);
  else if constexpr (kOneInstruction && __is_same(Op, Min))
    return __reduce_min_sync(0xffffffffu, x);
  else if constexpr (kOneInstruction && __is_same(Op, Max))
    return __reduce_max_sync(0xffffffffu, x);
  else
#endif
  {
#pragma unroll
    for (int lanes = N / 2; lanes >= Stride; lanes /= 2) x = op(x, shuffle_xor(x, lanes));
    return x;
  }
}

}  // namespace kv
