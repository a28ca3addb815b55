// Tensors as Images. Included by the *_op.cpp files of operators that take them.
#pragma once

#include "core/images.h"
#include "glue/glue.h"

namespace kv {

// (B, C, H, W) of any strides. One image, B = 1, serves a larger batch.
template <class T>
inline Images<T> images(Tensor const& x, int64_t batch) {
  return {data_ptr<T>(x), x.size(0) == 1 && batch > 1 ? 0 : x.stride(0),
          x.stride(1),    x.stride(2),
          x.stride(3),    batch,
          x.size(2),      x.size(3),
          int(x.size(1))};
}

}  // namespace kv
