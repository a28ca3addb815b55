// Image planes without rows, for statistics of whole planes. Included by *_op.cpp files.
#pragma once

#include "glue/glue.h"

namespace kv {

// `x` itself, or a dense copy: all pixels of a plane are then one row.
inline Tensor dense(Tensor const& x, Layout layout) {
  bool const last = layout == Layout::channels_last;
  if (last ? x.stride(2) == x.size(3) * x.size(1) : x.stride(3) == 1 && x.stride(2) == x.size(3)) return x;
  return last ? conform(torch::stable::contiguous(x), layout) : torch::stable::contiguous(x);
}

// The planes of a dense image tensor, each as one row: pixel i is i * step elements behind the first one.
template <class T>
Planes<T> flat_planes(Tensor const& x, Layout layout) {
  auto* data = static_cast<T*>(const_cast<void*>(static_cast<void const*>(x.const_data_ptr())));
  int64_t const b = x.size(0), c = x.size(1), n = x.size(2) * x.size(3);
  if (layout == Layout::channels_last) return {data, b, c, x.stride(0), 1, n * c, 1, n, c};
  if (x.stride(0) == c * x.stride(1) || b == 1) return {data, b * c, 1, x.stride(1), 0, n, 1, n, 1};
  return {data, b, c, x.stride(0), x.stride(1), n, 1, n, 1};
}

// Pixels of a plane are counted in ints.
inline void check_flat(char const* op, Tensor const& x) {
  check_images(op, "input", x);
  KV_CHECK(x.size(2) <= INT32_MAX / x.size(3), op, ": expected fewer than 2^31 pixels a plane");
}

}  // namespace kv
