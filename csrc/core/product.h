// Products that stay apart from sums. Included by headers of formulas.
#pragma once

#include "hd.h"

namespace kv {

// a * b, rounded: the compiler must not contract it with a sum into an fma. The result then has the same bits on every
// processor.
template <class V, class W>
KV_HD V product(V a, W b) {
#if defined(__CUDA_ARCH__)
  if constexpr (sizeof(V) == sizeof(float))
    return __fmul_rn(a, b);
  else
    return __dmul_rn(a, b);
#else
  V p = a * b;
#if defined(__x86_64__)
  asm("" : "+x"(p));
#else
  asm("" : "+w"(p));
#endif
  return p;
#endif
}

}  // namespace kv
