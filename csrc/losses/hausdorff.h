// The Hausdorff loss by erosions, of predictions (B, C, pixels) and labels (B, pixels), pixels being those of images or
// volumes. What a class differs by, b_0 = (prediction - [it is the label])^2, is eroded k times, each time by
//
//   c_i = max(mean of b_(i-1) at a pixel and its direct neighbors, zeros beyond the image - 1/2, 0)
//   b_i = (c_i - low) / (high - low), of the smallest and largest c_i of the plane; c_i where it is flat
//
// and the loss of a pixel is the sum of i^alpha b_i. Backward, with g the gradients by b_i, A the sum of g and D that
// of g b_i, c_i gets g / (high - low); the smallest one (D - A) / (high - low) and the largest one -D / (high - low)
// besides, shared between equal ones; and nothing where it is 0. The mean is its own transpose.
//
// Included by hausdorff_cpu.cpp, hausdorff.cu and hausdorff_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv {

// The pixels of a plane, of an image if its depth is 0.
struct Extent {
  int64_t depth, height, width;

  KV_HD int64_t size() const { return max(depth, int64_t(1)) * height * width; }
  KV_HD int taps() const { return depth > 0 ? 7 : 5; }
};

template <class F>
struct Differences {
  F const* pred;
  int64_t const* target;  // one for all samples if one_target
  bool one_target;
  int64_t batch, classes;
  Extent extent;

  KV_HD int64_t planes() const { return batch * classes; }
  // Prediction - label, NaN where that is no class.
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
  F* map;   // (B, C, pixels), or null for
  F* sums;  // (B, C)
  // Of CUDA's kernel; see hausdorff.cu.
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

// Of a plane's c_i.
template <class F>
struct ValueRange {
  F low, high;

  KV_HD bool is_flat() const { return high == low; }
  KV_HD F from() const { return is_flat() ? F(0) : low; }
  KV_HD F scale() const { return is_flat() ? F(1) : F(1) / (high - low); }
};

// What g turns into on its way from b_i to c_i.
template <class F>
struct NormalizeVjp {
  F scale, top, of_low, of_high;  // top: the largest b_i
  bool all;                       // no c_i is 0

  // Of the sums of g, of g b_i, and of how many pixels are the smallest and the largest ones.
  KV_HD static NormalizeVjp of(ValueRange<F> const& span, F sum, F product, F lowest, F highest) {
    F const scale = span.scale(), top = (span.high - span.low) * scale;
    if (span.is_flat()) return {scale, top, F(0), F(0), span.low > 0};
    return {scale, top, (product - sum) * scale / lowest, -product * scale / highest, span.low > 0};
  }
  template <class V>
  KV_HD V operator()(V g, V b) const {
    V const zero{};
    V const derivative = g * scale + (b == zero ? zero + of_low : zero) + (b == zero + top ? zero + of_high : zero);
    return all ? derivative : V(b > zero ? derivative : b <= zero ? zero : b);  // b itself where it is NaN
  }
};

// Of CUDA's kernels, which work on `at_once` planes together: pixels of a block, and what is in `maps` and `numbers`
// for each pixel and block of a plane.
constexpr int kErosionChunk = 2048;
constexpr int64_t kErosionMaps = 2, kErosionNumbers = 5;              // two c_i; low and high of both, and a sum
constexpr int64_t erosion_maps_backward(int64_t k) { return k + 2; }  // all c_i, and g by two of them
constexpr int64_t erosion_numbers_backward(int64_t k) { return 2 * k + 2 * 4; }  // and four sums of each g

}  // namespace kv
