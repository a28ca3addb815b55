// The range of every plane mapped to a given one, and its gradient: two passes, the first of which finds what the
// second needs to know of the plane. Included by min_max_cpu.cpp, min_max.cu and min_max_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

// y = (x - smallest) * scale / (largest - smallest + eps) + low
template <class T>
struct MinMax {
  using F = Compute<T>;
  Planes<T const> x;  // flat: a plane is a row
  Planes<T> y;
  T* range;  // smallest and largest of every plane; NaN where it has one
  F low, scale, eps;
  int64_t chunk, chunks;  // CUDA: pixels of a plane that are one block's, and how many of these a plane has
  F* partial;             // CUDA: the ranges of all chunks
};

template <class T>
struct MinMaxBackward {
  using F = Compute<T>;
  Planes<T const> grad, x;
  T const* range;
  Planes<T> grad_x;
  F scale, eps;
  int64_t chunk, chunks;
  F* partial;  // CUDA: the RangeSums of all chunks
};

KV_KERNEL(min_max, MinMax)
KV_KERNEL(min_max_backward, MinMaxBackward)

// What the gradient needs of a plane: sums of grad and of grad * (x - smallest), and how many pixels are smallest and
// largest, which share their gradient.
template <class F>
struct RangeSums {
  F grad, product, smallest, largest;
};

template <class F>
struct RangeGradient {
  F factor, to_smallest, to_largest;
  KV_HD RangeGradient(RangeSums<F> const& sums, F smallest, F largest, F scale, F eps) {
    F const span = largest - smallest + eps;
    factor = scale / span;
    F const of_span = factor * sums.product / span;
    to_smallest = (of_span - factor * sums.grad) / sums.smallest;
    to_largest = -of_span / sums.largest;
  }
};

}  // namespace kv
