// Sets rectangles of images to a value: x <= column < x + width and y <= row < y + height, for pixels at whole numbers.
// Included by erase_cpu.cpp, erase.cu and erase_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::augmentation {

template <class T>
struct EraseRectangles {
  Planes<T const> x;
  Planes<T> y;
  float const* boxes;                                // (B, N, 4): x, y, width, height
  Compute<T> const* values;                          // (B, C)
  int64_t samples, num_boxes;                        // B, N
  int64_t planes_per_sample;                         // 1 where a plane has all channels
  int64_t box_stride, value_stride, channel_stride;  // of a sample, and of a channel

  KV_HD float const* box(int64_t b, int64_t i) const { return boxes + b * box_stride + 4 * i; }
  // Of an element of a row of plane c of a sample.
  KV_HD Compute<T> value(int64_t b, int64_t c, int64_t element) const {
    return values[b * value_stride + (channel_stride && x.step > 1 ? element % x.step : c) * channel_stride];
  }
};

KV_KERNEL(erase_rectangles, EraseRectangles)

// The pixels [begin, end) of a side that are erased. NaN erases none.
struct ErasedRange {
  int64_t begin = 0, end = 0;

  KV_HD ErasedRange(float first, float side, int64_t size) {
    double const low = first, high = low + side;
    if (!(high > low)) return;
    begin = ceil_within(low, size);
    end = ceil_within(high, size);
  }
  static KV_HD int64_t ceil_within(double x, int64_t size) {
    if (!(x > 0)) return 0;
    if (x >= double(size)) return size;
    int64_t const whole = int64_t(x);
    return whole + (double(whole) < x);
  }
  KV_HD bool contains(int64_t i) const { return begin <= i && i < end; }
};

}  // namespace kv::augmentation
