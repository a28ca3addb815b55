// Sets parts of images to a value: rectangles, x <= column < x + width and y <= row < y + height for pixels at whole
// numbers, the lines of grids, or what masks mark.
#pragma once

#include "core/image_list.h"
#include "core/isa.h"
#include "core/trigonometry.h"

namespace kv::augmentation {

template <class T>
struct Erase {
  using Stored = T;
  Planes<T const> x;
  Planes<T> y;
  Compute<T> const* values;              // (B, C); null: what the results hold stays there
  int64_t samples;                       // B
  int64_t planes_per_sample;             // 1 where a plane has all channels
  int64_t value_stride, channel_stride;  // of a sample, and of a channel

  KV_HD bool keeps_erased() const { return !values; }
  // Of an element of a row of plane c of a sample.
  KV_HD Compute<T> value(int64_t b, int64_t c, int64_t element) const {
    return values[b * value_stride + (channel_stride && x.step > 1 ? element % x.step : c) * channel_stride];
  }
};

template <class T>
struct EraseRectangles : Erase<T> {
  float const* boxes;  // (B, N, 4): x, y, width, height
  int64_t num_boxes, box_stride;

  KV_HD float const* box(int64_t b, int64_t i) const { return boxes + b * box_stride + 4 * i; }
  // Leaves samples out at the front; images are not among what it changes.
  KV_HD void skip(int64_t count) {
    this->values += count * this->value_stride;
    boxes += count * box_stride;
  }
};

constexpr int kGridNumbers = 5;
template <class T>
struct EraseGrid : Erase<T> {
  float const* grids;  // (B, kGridNumbers), see GridLines
  int64_t grid_stride;

  // As that of rectangles.
  KV_HD void skip(int64_t count) {
    this->values += count * this->value_stride;
    grids += count * grid_stride;
  }
};

template <class T>
struct EraseMarked : Erase<T> {
  uint8_t const* marks;  // (B, H, W) of the largest image, 0 for pixels that stay
  int64_t mark_stride, row_stride;

  // As that of rectangles.
  KV_HD void skip(int64_t count) {
    this->values += count * this->value_stride;
    marks += count * mark_stride;
  }
  KV_HD bool contains(int64_t b, int64_t column, int64_t row) const {
    return marks[b * mark_stride + row * row_stride + column] != 0;
  }
};

KV_KERNEL(erase_rectangles, EraseRectangles)
KV_KERNEL(erase_grid, EraseGrid)

// The same of images of different sizes: `all` is what the samples of the table have in common.
template <class All>
struct EraseList {
  using T = typename All::Stored;
  All all;
  ListedSamples list;
  int channels;

  // A sample as a batch of one.
  KV_HD All sample(int b) const {
    All one = all;
    one.skip(b);
    one.samples = 1;
    one.x = planes_of(images_of<T>(list.images[b], channels), list.interleaved);
    one.y = planes_of(images_of<T>(list.results[b], channels, list.interleaved), list.interleaved);
    return one;
  }
};

template <class T>
struct EraseRectanglesList : EraseList<EraseRectangles<T>> {};
template <class T>
struct EraseGridList : EraseList<EraseGrid<T>> {};
template <class T>
struct EraseMarkedList : EraseList<EraseMarked<T>> {};

// On the CPU an item is some rows of all planes, on CUDA a tile.
KV_KERNEL(erase_rectangles_list, EraseRectanglesList)
KV_KERNEL(erase_grid_list, EraseGridList)
KV_KERNEL(erase_marked_list, EraseMarkedList)
constexpr int kEraseRows = 8, kEraseColumns = 2048;

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

// The lines of a grid that is turned about the center of an image, at whole pixels. Its numbers are the width of lines
// as a fraction of a cell, the angle, the offsets along x and y in cells, and how many cells the shorter side has.
// NaN has no lines.
struct GridLines {
  double cosine, sine, center_x, center_y;
  int cell, line, first_x, first_y;

  GridLines() = default;
  KV_HD GridLines(float const* numbers, int64_t height, int64_t width)
      : center_x(double(width - 1) / 2), center_y(double(height - 1) / 2) {
    double const size = double(min(height, width));
    sin_cos(double(numbers[1]), sine, cosine);
    cell = whole(size / max(double(numbers[4]), 1.), 2, size);
    line = numbers[1] == numbers[1] ? whole(cell * double(numbers[0]), 1, cell) : 0;
    first_x = whole(double(numbers[2]) * cell, -cell, cell);
    first_y = whole(double(numbers[3]) * cell, -cell, cell);
  }
  // The floor, within bounds; NaN is the lower one.
  static KV_HD int whole(double x, double low, double high) {
    double const within = x > low ? (x < high ? x : high) : low;
    int const towards_zero = int(within);
    return towards_zero - (double(towards_zero) > within);
  }
  KV_HD bool is_line(double x, int first) const {
    constexpr double shift = 0x1.8p52;  // rounds half to even
    int const at = (int((x + shift) - shift) - first) % cell;
    return (at < 0 ? at + cell : at) < line;
  }
  KV_HD bool contains(int64_t column, int64_t row) const {
    double const x = double(column) - center_x, y = double(row) - center_y;
    return line > 0 &&
           (is_line(cosine * x - sine * y + center_x, first_x) || is_line(sine * x + cosine * y + center_y, first_y));
  }
};

}  // namespace kv::augmentation
