// Gradients that are one number.
#pragma once

#include "glue/glue.h"

namespace kv {

// Whether a gradient is a scalar expanded to all pixels, as the gradient of a sum is. Kernels on CUDA read the scalar.
inline bool is_expanded_scalar([[maybe_unused]] Tensor const& grad) {
#if defined(KV_CUDA)
  for (int64_t i = 0; i < grad.dim(); ++i)
    if (grad.size(i) > 1 && grad.stride(i) != 0) return false;
  return grad.numel() > 1;
#else
  return false;
#endif
}

}  // namespace kv
