// Images of blocks: each pixel becomes the value of the block that it lies in. corruption/pixelate.py of
// kvision.augmentation defines them.
#pragma once

#include "core/isa.h"
#include "core/stencils/filter_list.h"
#include "core/view.h"

namespace kv::augmentation {

// A block is the mean of what it covers of pixels, or of the pixels whose centers it covers, or the pixel that its
// first corner lies in; then pixels show the block that their first corners lie in.
enum class BlockValue : int { mean, mean_of_whole, pixel };
constexpr int kBlockValues = 3;

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
  // The block that pixel i shows.
  KV_HD unsigned block(unsigned i) const {
    return value == BlockValue::pixel ? i * count / size : (2 * i + 1) * count / (2 * size);
  }
  // The first pixel that shows a block; those up to the first one of the next block do, too.
  KV_HD unsigned first_shown(unsigned block) const {
    return value == BlockValue::pixel ? (block * size + count - 1) / count
                                      : (2 * block * size + count - 1) / (2 * count);
  }
  // The first block that may read pixel i; the next one may, too.
  KV_HD unsigned first_reader(unsigned i) const {
    if (value == BlockValue::pixel) return (i * count + size - 1) / size;
    return value == BlockValue::mean ? i * count / size : ((2 * i + 1) * count - 1) / (2 * size);
  }
};

// What a block reads: pixels [begin, end), each with its weight above 0, of the sum `total`. A block begins at a pixel
// of at least its own number.
struct BlockPixels {
  unsigned begin, end, first, last, count, total;
  bool is_whole;

  // With the pixels, which take divisions to find.
  KV_HD BlockPixels(BlockAxis const& axis, unsigned block, unsigned begin, unsigned end)
      : begin(begin),
        end(end),
        first(block * axis.size),
        last(first + axis.size),
        count(axis.count),
        is_whole(axis.value != BlockValue::mean) {
    total = is_whole ? end - begin : axis.size;
  }
  KV_HD BlockPixels(BlockAxis const& axis, unsigned block) : BlockPixels(axis, block, 0, 0) {
    begin = first / count;
    end = begin + 1;
    if (axis.value == BlockValue::mean) end = (last + count - 1) / count;
    if (axis.value == BlockValue::mean_of_whole) begin = (2 * first / count + 1) / 2, end = (2 * last / count + 1) / 2;
    if (is_whole) total = end - begin;
  }
  KV_HD float weight(unsigned i) const {
    return is_whole ? 1 : float(min((i + 1) * count, last) - max(i * count, first));
  }
};
// The weights of a pixel in the first block that may read it and in the next one, as BlockPixels has them, or 0.
struct ReaderWeights {
  float v[2];

  KV_HD ReaderWeights(BlockAxis const& axis, unsigned i, unsigned reader) {
    unsigned const low = i * axis.count, high = low + axis.count, border = (reader + 1) * axis.size;
    if (axis.value == BlockValue::mean)
      v[0] = float(min(high, border) - low), v[1] = high > border ? float(high - border) : 0;
    else
      v[0] = axis.value == BlockValue::mean_of_whole || border - axis.size < high, v[1] = 0;
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
  KV_HD void select(int64_t b) { counts += b * count_stride; }
};

template <class T>
struct PixelateList : FilterList<Pixelate<T>, T> {};

// Elements of a row, on CUDA.
constexpr int kMaxPixelateRow = 10240;

KV_KERNEL(pixelate, Pixelate)
KV_KERNEL(pixelate_list, PixelateList)
// The transposes, from gradients x of results to those of images.
KV_KERNEL(pixelate_backward, Pixelate)
KV_KERNEL(pixelate_backward_list, PixelateList)

}  // namespace kv::augmentation
