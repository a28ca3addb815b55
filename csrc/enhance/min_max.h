// Min-max normalization of every plane and its gradient, in two passes: the first reduces a plane, the second maps it.
#pragma once

#include "core/isa.h"
#include "core/stencils/gradient_list.h"
#include "core/view.h"

namespace kv::enhance {

// y = (x - smallest) * scale / (largest - smallest + eps) + low
template <class T>
struct MinMax {
  using F = Compute<T>;
  Planes<T const> x;  // flat: each plane is one row
  Planes<T> y;
  T* range;  // minimum and maximum of every plane; NaN if the plane has one
  F low, scale, eps;
  int64_t chunk, chunks;    // CUDA: pixels of a plane per block, and the number of such chunks in a plane
  F* partial;               // CUDA: the ranges of all chunks
  bool clamps, keeps_flat;  // results to the new range, which rounding may leave; planes of one value as they are
  int64_t sample_planes = 0;

  KV_HD void select(int64_t b) { range += 2 * b * sample_planes; }
  template <class V>
  KV_HD V mapped(V x, F smallest, F factor) const {
    V const y = (x - smallest) * factor + low, bottom = V{} + low, top = V{} + (low + scale);
    if (!clamps) return y;
    V const above = y < bottom ? bottom : y;  // NaN stays
    return above > top ? top : above;
  }
};

// Of lists `partial` are those of the blocks.
template <class T>
struct MinMaxList : FilterList<MinMax<T>, T> {};

template <class T>
struct MinMaxBackward {
  using F = Compute<T>;
  Planes<T const> grad, x;
  T const* range;
  Planes<T> grad_x;
  F scale, eps;
  int64_t chunk, chunks;
  F* partial;  // CUDA: the RangeSums of all chunks
  bool keeps_flat = false;
  int64_t sample_planes = 0;

  KV_HD void select(int64_t b) { range += 2 * b * sample_planes; }
};

// Of lists `partial` are those of the blocks.
template <class T>
struct MinMaxBackwardList : GradientList<MinMaxBackward<T>, T, true> {};

KV_KERNEL(min_max, MinMax)
KV_KERNEL(min_max_list, MinMaxList)
KV_KERNEL(min_max_backward, MinMaxBackward)
KV_KERNEL(min_max_list_backward, MinMaxBackwardList)

// Sums of a plane that the gradient needs: of grad, of grad * (x - smallest), and the numbers of pixels with the
// smallest and the largest value, among which the gradient of these is split.
template <class F>
struct RangeSums {
  F grad, product, smallest, largest;
};

template <class F>
struct RangeGradient {
  F factor, grad_smallest, grad_largest;
  KV_HD RangeGradient(RangeSums<F> const& sums, F smallest, F largest, F scale, F eps) {
    F const span = largest - smallest + eps;
    factor = scale / span;
    F const of_span = factor * sums.product / span;
    grad_smallest = (of_span - factor * sums.grad) / sums.smallest;
    grad_largest = -of_span / sums.largest;
  }
};

}  // namespace kv::enhance
