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
// The transposes, from gradients x of results to those of images.
KV_KERNEL(sum_of_moved_backward, SumOfMoved)
KV_KERNEL(sum_of_moved_backward_list, SumOfMovedList)

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

// The transpose: the positions [begin, end) along an axis that may read a pixel, each with a weight. Pixels at the
// border are read from outside, too.
template <class F>
struct ReadersOfPixel {
  F scale, shift;
  int pixel, size, begin, end;

  KV_HD ReadersOfPixel(F scale, F shift, int pixel, int size)
      : scale(scale), shift(shift), pixel(pixel), size(size), begin(0), end(size) {
    if (!(scale > F(0.01))) return;
    F const low = (F(pixel - 1) - shift) / scale, high = (F(pixel + 1) - shift) / scale + 2;
    if (pixel > 0) begin = low > 0 ? low < F(size) ? int(low) : size : 0;
    if (pixel < size - 1) end = high > 0 ? high < F(size) ? int(high) : size : 0;
  }
  KV_HD F weight(int i) const {
    PairOfTaps<F> const taps(scale * F(i) + shift, size);
    return (taps.first == pixel ? 1 - taps.t : F(0)) + (taps.t > 0 && taps.second == pixel ? taps.t : F(0));
  }
};

}  // namespace kv::augmentation
