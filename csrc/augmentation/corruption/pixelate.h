// Images of blocks: each pixel becomes the mean of the block that its center lies in. corruption/pixelate.py of
// kvision.augmentation defines them. Included by pixelate_cpu.cpp, pixelate.cu and pixelate_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::augmentation {

// A block is the mean of what it covers of pixels, or of the pixels whose centers it covers.
enum class BlockValue : int { mean, mean_of_whole };
constexpr int kBlockValues = 2;

// Blocks along an axis of `size` pixels, `count` of them of equal lengths. Positions are multiples of a pixel divided
// by `count`, so that they are whole numbers; all fit 32 bits.
constexpr int kMaxPixelateSide = 32767;
struct BlockAxis {
  BlockValue value;
  unsigned size, count;

  BlockAxis() = default;
  KV_HD BlockAxis(BlockValue value, float blocks, int64_t pixels) : value(value), size(unsigned(pixels)) {
    count = blocks > 1 ? (blocks < float(size) ? unsigned(blocks) : size) : 1;  // NaN is one
  }
  // The block that the center of pixel i lies in.
  KV_HD unsigned block(unsigned i) const { return (2 * i + 1) * count / (2 * size); }
};

// What a block reads: pixels [begin, end), each with its weight.
struct BlockPixels {
  unsigned begin, end, first, last, count;
  BlockValue value;

  KV_HD BlockPixels(BlockAxis const& axis, unsigned block)
      : first(block * axis.size), last(first + axis.size), count(axis.count), value(axis.value) {
    begin = first / count;
    end = (last + count - 1) / count;
  }
  KV_HD float weight(unsigned i) const {
    unsigned const low = i * count, high = low + count, center = low + high;
    if (value == BlockValue::mean_of_whole) return center > 2 * first && center <= 2 * last ? 1 : 0;
    return float(min(high, last) - max(low, first));
  }
};

template <class T>
struct Pixelate {
  Planes<T const> x;
  Planes<T> y;
  float const* counts;  // (B, 2): blocks down and across
  int64_t count_stride, planes_per_sample;
  BlockValue value;

  KV_HD BlockAxis down(int64_t b) const { return {value, counts[b * count_stride], x.height}; }
  KV_HD BlockAxis across(int64_t b) const { return {value, counts[b * count_stride + 1], x.width}; }
};

// Elements of a row, on CUDA.
constexpr int kMaxPixelateRow = 10240;

KV_KERNEL(pixelate, Pixelate)

}  // namespace kv::augmentation
