// Checks of square patches (B, 1, n, n). Included by the *_op.cpp files of operators that take them.
#pragma once

#include "glue/glue.h"
#include "patch_gradient.h"

namespace kv::feature {

// Returns n.
inline int check_patches(char const* op, Tensor const& x) {
  KV_CHECK(x.dim() == 4 && x.size(1) == 1 && x.size(2) == x.size(3) && x.size(2) > 0, op,
           ": expected patches of shape (B, 1, n, n)");
#if defined(KV_CUDA)
  KV_CHECK(x.size(2) <= kLargestSharedPatch, op, ": expected patches of at most ", kLargestSharedPatch, " pixels");
#endif
  KV_CHECK(x.size(0) <= INT32_MAX && x.size(2) < 1 << 15, op,
           ": expected less than 2^31 patches, of less than 2^15 rows");
  return int(x.size(2));
}

inline void check_patch_gradient(char const* op, Tensor const& grad, Tensor const& x,
                                 std::vector<int64_t> const& sizes) {
  bool fits =
      grad.dim() == int64_t(sizes.size()) && grad.scalar_type() == x.scalar_type() && grad.device() == x.device();
  for (size_t i = 0; fits && i < sizes.size(); ++i) fits = grad.size(int64_t(i)) == sizes[i];
  KV_CHECK(fits, op, ": grad does not fit the patches");
}

}  // namespace kv::feature
