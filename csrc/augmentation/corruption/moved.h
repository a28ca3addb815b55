// Weighted sums of moved and scaled copies of images: blurs along paths. corruption/moved.py of kvision.augmentation
// defines them.
#pragma once

#include "augmentation/corruption/place_sample.h"
#include "core/isa.h"

namespace kv::augmentation {

template <class T>
struct SumOfMoved {
  T const* x;
  T* y;
  int64_t batch, channels, height, width;
  int64_t x_strides[4], y_strides[4];  // of sample, channel, row and pixel
  Compute<T> const* moves;             // (B, K, 4): scale, x, y, weight
  int64_t num_moves, move_stride;
};

// Of lists: `all` is what the samples have in common.
template <class T>
struct SumOfMovedList {
  SumOfMoved<T> all;
  ListedSamples list;

  KV_HD SumOfMoved<T> sample(int b) const {
    SumOfMoved<T> one = all;
    place_sample(one, list, b);
    one.moves += b * one.move_stride;
    return one;
  }
};

KV_KERNEL(sum_of_moved, SumOfMoved)
KV_KERNEL(sum_of_moved_list, SumOfMovedList)

// Pixels at a coordinate along an axis, which is clamped to the image: `first`, and `second` with weight `t`.
template <class F>
struct PairOfTaps {
  int first, second;
  F t;

  KV_HD PairOfTaps(F at, int size) {
    F const last = F(size - 1);
    at = at > 0 ? (at < last ? at : last) : F(0);  // NaN is 0
    first = int(at);
    t = at - F(first);
    second = t > 0 ? first + 1 : first;
  }
};

}  // namespace kv::augmentation
