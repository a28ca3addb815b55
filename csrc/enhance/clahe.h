// Contrast-limited adaptive histogram equalization in two steps: a table from level to level for every tile of a plane,
// then an interpolation of every pixel between the tables of the four nearest tiles.
//
//   +---+---+---+   Tiles, and the cells between their centers. All pixels of a cell use the same four tables.
//   | o-|-o-|-o |   Either axis has one cell more than it has tiles. In cells along the border, two of the
//   +-|-+-|-+-|-+   tables are the same.
//   | o-|-o-|-o |
//   +---+---+---+
#pragma once

#include "byte_histogram.h"
#include "core/ceil_div.h"
#include "core/isa.h"
#include "core/product.h"
#include "core/stencils/channel_list.h"
#include "plane_parameter.h"

namespace kv::enhance {

// The tiles or cells along one axis.
struct TileAxis {
  int count, size;  // tiles, and pixels of each; count * size may exceed `pixels`
  int pixels;
  bool half;  // the center of pixel i is at i + 1/2; OpenCV: at i

  // The first pixel of a cell; for the index after the last cell, the number of pixels.
  KV_HD int cell(int i) const {
    int64_t const twice = int64_t(size) * (2 * i - 1) - half;
    return int(clamp((twice + 1) >> 1, int64_t(0), int64_t(pixels)));
  }
  // The cell of a pixel.
  KV_HD int cell_of(int i) const { return int((2 * unsigned(i) + half + size) / (2 * unsigned(size))); }
  KV_HD int before(int cell) const { return max(cell - 1, 0); }
  KV_HD int after(int cell) const { return min(cell, count - 1); }
  // The interpolation weight of the later tile.
  template <class F>
  KV_HD F weight(int i, int cell) const {
    return product(F(i) + (half ? F(0.5) : F(0)), 1 / F(size)) - F(0.5) - F(cell - 1);
  }
  // The pixel index after repeated reflection at the borders.
  KV_HD int reflected(int i) const {
    if (i < pixels) return i;
    int const period = max(2 * (pixels - 1), 1);
    i %= period;
    return min(i, period - i);
  }
};

// The limit of the counts of a tile, from that of the contrast; without one, more than any count.
KV_HD int32_t limit_of_counts(double clip_limit, int64_t tile_pixels) {
  double const most = clip_limit * double(tile_pixels) / kLevels;
  return clip_limit > 0 && most < INT32_MAX ? max(int32_t(most), 1) : INT32_MAX;
}

constexpr int64_t kMaxTiles = (1 << 15) - 1;  // along an axis

// Tiles of equal size. Where one axis needs padding, OpenCV pads the other one as well.
KV_HD TileAxis tile_axis(int64_t pixels, int64_t tiles, bool fits, bool opencv) {
  int64_t const size = opencv && !fits ? pixels / tiles + 1 : ceil_div(pixels, tiles);
  return {int(tiles), int(size), int(pixels), !opencv};
}

template <class T>
struct Clahe {
  Planes<T const> x;  // one plane per channel
  Planes<T> y;
  TileAxis down, across;
  int32_t limit;  // of a tile's counts, where `clip_limits` is no tensor
  PlaneParameter<Compute<T>> clip_limits;
  bool to_levels;   // the result is rounded to levels
  uint8_t* tables;  // kLevels for every tile of every plane; null on the CPU if the work is divided by planes
  // CPU, with tables: whether a row of tiles has a NaN.
  uint8_t* has_nan = nullptr;

  KV_HD uint8_t* tables_of(int64_t plane) const { return tables + plane * down.count * across.count * kLevels; }
  KV_HD bool by_cells() const { return tables != nullptr; }
  KV_HD int32_t limit_of(int64_t plane) const {
    return clip_limits.data ? limit_of_counts(double(clip_limits.of(plane)), int64_t(down.size) * across.size) : limit;
  }
  KV_HD void set_axes(int64_t height, int64_t width, int64_t rows, int64_t columns, double clip_limit) {
    bool const fits = height % rows == 0 && width % columns == 0;
    down = tile_axis(height, rows, fits, to_levels), across = tile_axis(width, columns, fits, to_levels);
    limit = limit_of_counts(clip_limit, int64_t(down.size) * across.size);
  }
  KV_HD void select(int64_t b) {
    if (clip_limits.data) clip_limits.data += b * clip_limits.of_image;
  }
};

// Of lists the tables are those of the samples of a table.
template <class T>
struct ClaheList : FilterList<Clahe<T>, T> {
  int rows, columns;
  double clip_limit;

  KV_HD Clahe<T> sample(int b) const {
    Clahe<T> one = FilterList<Clahe<T>, T>::sample(b);
    by_channels(one.x), by_channels(one.y);
    one.set_axes(one.x.height, one.x.width, rows, columns, clip_limit);
    if (one.tables) one.tables += int64_t(b) * this->channels * rows * columns * kLevels;
    return one;
  }
};

// On the CPU the work is divided by planes. If there are few planes, it is divided by rows of cells, after a first pass
// for the tables that is divided by rows of tiles, so that more threads than planes can run.
KV_KERNEL(clahe, Clahe)
KV_KERNEL(clahe_list, ClaheList)
KV_KERNEL(clahe_tables, Clahe)  // CPU

// n / d for 0 <= n < 2^20 and d > 0. On CUDA without integer division: (n + 1/2) / d is at least 1 / (2 d) away from an
// integer, farther than its rounding error.
KV_HD int32_t small_quotient(int32_t n, int32_t d) {
#if defined(__CUDA_ARCH__)
  return int32_t(__fdividef(float(n) + 0.5f, float(d)));
#else
  return n / d;
#endif
}

// Redistribution of the counts above the clip limit: an equal amount for every level. OpenCV adds the remainder one by
// one to levels at equal distances.
struct Excess {
  int32_t each, rest, distance, inverse;
  KV_HD explicit Excess(int32_t excess)
      : each(int32_t(uint32_t(excess) / kLevels)),
        rest(int32_t(uint32_t(excess) % kLevels)),
        distance(rest ? small_quotient(kLevels, rest) : kLevels),
        inverse(small_quotient(1 << 16, distance) + 1) {}
  KV_HD int32_t of(int level) const {
    int const position = level * inverse >> 16;  // level / distance: both are at most 256
    return each + int32_t((position * distance == level) & (position < rest));
  }
};

// The levels in the tables of the four nearest tiles, above (a, b) and below (c, d), interpolated to the resulting
// pixel.
template <class V, class W>
KV_HD V mixed(V a, V b, V c, V d, W x, W y) {
  auto const between = [](V u, V v, W w) { return product(u, 1 - w) + product(v, w); };
  return between(between(a, b, x), between(c, d, x), y);
}

}  // namespace kv::enhance
