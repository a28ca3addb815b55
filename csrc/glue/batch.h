// Tensors that serve a batch. Included by the *_op.cpp files of operators that take several.
#pragma once

#include "glue/glue.h"

namespace kv {

// Contiguous, with as many samples: one serves all, as it may where vmap maps some of several tensors.
inline Tensor for_batch(Tensor const& x, int64_t batch) {
  if (x.size(0) != 1 || batch == 1) return dense(x);
  int64_t sizes[8] = {batch};
  for (int64_t i = 1; i < x.dim(); ++i) sizes[i] = x.size(i);
  Tensor all = empty({sizes, size_t(x.dim())}, x);
  return torch::stable::copy_(all, x);
}

// Raises unless x is like a tensor of these sizes, the first of which may be 1.
inline void check_fits(char const* op, char const* name, Tensor const& x, Tensor const& like,
                       std::vector<int64_t> const& sizes) {
  bool fits = x.dim() == int64_t(sizes.size()) && x.scalar_type() == like.scalar_type() && x.device() == like.device();
  for (int64_t i = 0; fits && i < x.dim(); ++i) fits = x.size(i) == sizes[size_t(i)] || (i == 0 && x.size(0) == 1);
  KV_CHECK(fits, op, ": ", name, " does not fit the other tensors");
}

}  // namespace kv
