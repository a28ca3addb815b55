// Hausdorff loss by erosions, of predictions (B, C, pixels) and labels (B, pixels) of images or volumes. The squared
// difference of a class, b_0 = (prediction - [the label is the class])^2, is eroded k times. An erosion is
//
//   c_i = max(mean of b_(i-1) at a pixel and its direct neighbors, zeros out of bounds - 1/2, 0)
//   b_i = (c_i - low) / (high - low), with the minimum and maximum of c_i in the plane; b_i = c_i if it is flat
//
// and the loss of a pixel is the sum of i^alpha b_i. In the backward pass let g be the gradient of b_i, A the sum of g,
// and D the sum of g b_i. The gradient of c_i is g / (high - low). The minimum additionally receives (D - A) / (high -
// low) and the maximum -D / (high - low), split evenly among equal pixels. Where c_i is 0, its gradient is 0 in any
// case. The mean is its own transpose.
//
// Where little survives, high - low is tiny. So b_i is a quotient, which is exactly 1 at the maximum, and the terms of
// a gradient are added before they are divided: those of a single surviving pixel cancel exactly.
#pragma once

#include "core/isa.h"

namespace kv::losses {

// The size of a plane: a volume, or an image if depth is 0.
struct Extent {
  int64_t depth, height, width;

  KV_HD int64_t size() const { return max(depth, int64_t(1)) * height * width; }
  KV_HD int taps() const { return depth > 0 ? 7 : 5; }
};

template <class F>
struct Differences {
  F const* pred;
  int64_t const* target;  // one_target: broadcast to all samples
  bool one_target;
  int64_t batch, classes;
  Extent extent;

  KV_HD int64_t planes() const { return batch * classes; }
  // Prediction - label; NaN if the label is not a class.
  KV_HD F at(int64_t plane, int64_t i) const {
    int64_t const n = extent.size(), b = plane / classes, label = target[(one_target ? 0 : b) * n + i];
    F const own = label == plane - b * classes ? F(1) : F(0);
    return label >= 0 && label < classes ? pred[plane * n + i] - own : F(__builtin_nanf(""));
  }
};

template <class F>
struct Hausdorff {
  Differences<F> differences;
  double alpha;
  int64_t k;
  F* map;   // (B, C, pixels); null: the result is `sums`
  F* sums;  // (B, C)
  // Working memory of the CUDA kernel; defined in hausdorff.cu.
  F *maps, *numbers;
  int64_t at_once;
};

template <class F>
struct HausdorffBackward {
  Differences<F> differences;
  double alpha;
  int64_t k;
  F const* grad;  // (B, C, pixels), or (B, C) if of_sums
  bool of_sums;
  F* grad_pred;
  F *maps, *numbers;
  int64_t at_once;
};

KV_KERNEL(hausdorff, Hausdorff)
KV_KERNEL(hausdorff_backward, HausdorffBackward)

// The minimum and maximum of a plane's c_i.
template <class F>
struct ValueRange {
  F low, high;

  KV_HD bool is_flat() const { return high == low; }
  KV_HD F from() const { return is_flat() ? F(0) : low; }
  KV_HD F width() const { return is_flat() ? F(1) : high - low; }
};

// Maps the gradient of b_i to the gradient of c_i.
template <class F>
struct NormalizeVjp {
  F width, of_low, of_high;
  bool all;  // no c_i is 0

  // From the sums of g and of g b_i, and the numbers of pixels with the minimum and with the maximum.
  KV_HD static NormalizeVjp of(ValueRange<F> const& span, F sum, F product, F lowest, F highest) {
    if (span.is_flat()) return {F(1), F(0), F(0), span.low > 0};
    return {span.width(), (product - sum) / lowest, -product / highest, span.low > 0};
  }
  template <class V>
  KV_HD V operator()(V g, V b) const {
    V const zero{}, one = zero + F(1);
    V const derivative = (g + (b == zero ? zero + of_low : zero) + (b == one ? zero + of_high : zero)) / width;
    return all ? derivative : V(b > zero ? derivative : b <= zero ? zero : b);  // NaN in b stays NaN
  }
};

// The CUDA kernels process `at_once` planes together: pixels of a chunk, and the numbers of elements in `maps` per
// pixel and in `numbers` per chunk of a plane.
constexpr int kErosionChunk = 2048;
constexpr int64_t kErosionMaps = 2, kErosionNumbers = 5;              // two c_i; low and high of both, and a sum
constexpr int64_t erosion_maps_backward(int64_t k) { return k + 2; }  // all c_i, and two g
constexpr int64_t erosion_numbers_backward(int64_t k) { return 2 * k + 2 * 4; }  // and four sums of both g

}  // namespace kv::losses
