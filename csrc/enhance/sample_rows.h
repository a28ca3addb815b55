// Checks and dispatch for tensors (rows, samples), of which each row is counted. Included by *_op.cpp files.
#pragma once

#include "glue/glue.h"

namespace kv::enhance {

inline void check_rows(char const* op, Tensor const& x) {
  KV_CHECK(x.dim() == 2, op, ": expected x of 2 axes, got ", x.dim());
  KV_CHECK(x.scalar_type() == ScalarType::Float || x.scalar_type() == ScalarType::Double, op,
           ": no kernel for this dtype");
}

inline void check_row_grad(char const* op, Tensor const& grad, Tensor const& x, int64_t bins) {
  KV_CHECK(grad.dim() == 2 && grad.size(0) == x.size(0) && grad.size(1) == bins &&
               grad.scalar_type() == x.scalar_type() && grad.device() == x.device(),
           op, ": grad differs in shape, dtype or device from the counts of x");
}

// Calls f with the type of x: float or double.
template <class F>
void dispatch_row_dtype(Tensor const& x, F f) {
  if (x.scalar_type() == ScalarType::Double)
    f(Type<double>{});
  else
    f(Type<float>{});
}

}  // namespace kv::enhance
