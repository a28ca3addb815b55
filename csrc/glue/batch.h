// Parameters that broadcast over a batch. Included by the *_op.cpp files of operators that take several tensors.
#pragma once

#include "glue/glue.h"

namespace kv {

// `x` contiguous and with `batch` samples. A tensor with one sample is expanded: vmap may map some of several tensors.
inline Tensor expand_batch(Tensor const& x, int64_t batch) {
  if (x.size(0) != 1 || batch == 1) return dense(x);
  int64_t sizes[8] = {batch};
  for (int64_t i = 1; i < x.dim(); ++i) sizes[i] = x.size(i);
  Tensor all = empty({sizes, size_t(x.dim())}, x);
  return torch::stable::copy_(all, x);
}

// Raises unless x has these sizes, of which the first may be 1, and the dtype and device of `like`.
inline void check_sizes(char const* op, char const* name, Tensor const& x, Tensor const& like,
                        std::vector<int64_t> const& sizes) {
  bool matches =
      x.dim() == int64_t(sizes.size()) && x.scalar_type() == like.scalar_type() && x.device() == like.device();
  for (int64_t i = 0; matches && i < x.dim(); ++i)
    matches = x.size(i) == sizes[size_t(i)] || (i == 0 && x.size(0) == 1);
  KV_CHECK(matches, op, ": ", name, " does not match the other tensors in shape, dtype or device");
}

}  // namespace kv
