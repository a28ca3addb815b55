// Host/device attributes, the compute type of a storage type, min, max, clamp, sqrt. Included by every header of core/.
#pragma once

#include <cstdint>

// Inlining is forced for correctness: every CPU kernel file is compiled once per instruction set, and the linker could
// take a helper that has a symbol from the wrong one. `tools/audit_symbols.py` checks that there is none.
#if defined(__CUDACC__)
#define KV_HD __host__ __device__ __forceinline__
#else
#define KV_HD inline __attribute__((always_inline))
#endif
#define KV_INLINE __attribute__((always_inline))  // of lambdas

namespace kv {

// The type arithmetic runs in: 16-bit floats and bytes are stored, float computes.
template <class T>
struct compute {
  using type = float;
};
template <>
struct compute<double> {
  using type = double;
};
template <class T>
using Compute = typename compute<T>::type;

template <class T>
KV_HD T min(T a, T b) {
  return b < a ? b : a;
}
template <class T>
KV_HD T max(T a, T b) {
  return a < b ? b : a;
}
template <class T>
KV_HD T clamp(T x, T low, T high) {
  return min(max(x, low), high);
}
KV_HD float sqrt(float x) { return __builtin_sqrtf(x); }
KV_HD double sqrt(double x) { return __builtin_sqrt(x); }

}  // namespace kv
