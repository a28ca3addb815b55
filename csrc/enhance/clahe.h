// Contrast-limited adaptive equalization in two steps: a table from level to level for every tile of a plane, and
// pixels mapped by the tables of the four tiles around them. Included by clahe_cpu.cpp, clahe.cu, clahe_op.cpp.
//
//   +---+---+---+   Tiles, and the cells between their centers: all pixels of a cell are mapped by the same
//   | o-|-o-|-o |   four tables. There is one cell more than tiles along either axis; in those along the rim
//   +-|-+-|-+-|-+   two tables are the same one.
//   | o-|-o-|-o |
//   +---+---+---+
#pragma once

#include "byte_histogram.h"
#include "core/isa.h"

namespace kv {

// a * b, rounded. The compiler does not join it with a sum into one step, so the result has the same bits on every
// processor, and those of OpenCV where it is asked for them.
template <class V, class W>
KV_HD V product(V a, W b) {
#if defined(__CUDA_ARCH__)
  if constexpr (sizeof(V) == sizeof(float))
    return __fmul_rn(a, b);
  else
    return __dmul_rn(a, b);
#else
  V p = a * b;
#if defined(__x86_64__)
  asm("" : "+x"(p));
#else
  asm("" : "+w"(p));
#endif
  return p;
#endif
}

// The tiles or the cells along one axis.
struct TileAxis {
  int count, size;  // tiles, and pixels of each; together they may be more than `pixels`
  int pixels;
  bool half;  // pixel i is at i + 1/2; OpenCV has it at i

  // The first pixel of a cell; of the one behind the last, the number of pixels.
  KV_HD int cell(int i) const {
    int64_t const twice = int64_t(size) * (2 * i - 1) - half;
    return int(clamp((twice + 1) >> 1, int64_t(0), int64_t(pixels)));
  }
  KV_HD int before(int cell) const { return max(cell - 1, 0); }
  KV_HD int after(int cell) const { return min(cell, count - 1); }
  // How much of a pixel is the later tile's.
  template <class F>
  KV_HD F weight(int i, int cell) const {
    return product(F(i) + (half ? F(0.5) : F(0)), 1 / F(size)) - F(0.5) - F(cell - 1);
  }
  // The plane goes on by reflection, as often as it takes.
  KV_HD int reflected(int i) const {
    if (i < pixels) return i;
    int const period = max(2 * (pixels - 1), 1);
    i %= period;
    return min(i, period - i);
  }
};

template <class T>
struct Clahe {
  Planes<T const> x;  // a plane is a channel
  Planes<T> y;
  TileAxis down, across;
  int32_t limit;    // of a tile's counts
  bool to_levels;   // the result is rounded to levels
  uint8_t* tables;  // kLevels for every tile of every plane, on CUDA only
};

KV_KERNEL(clahe, Clahe)

// What is above the limit in all counts is spread: an equal share for every level, and the rest, as OpenCV does it, one
// by one to levels at equal distances.
struct Excess {
  int32_t share, rest, distance, inverse;
  KV_HD explicit Excess(int32_t excess)
      : share(excess / kLevels),
        rest(excess % kLevels),
        distance(rest ? kLevels / rest : kLevels),
        inverse((1 << 16) / distance + 1) {}
  KV_HD int32_t of(int level) const {
    int const place = level * inverse >> 16;  // level / distance: both are at most 256
    return share + (place * distance == level && place < rest);
  }
};

// The pixel that the tables of the tiles before and after it, up (a, b) and down (c, d), make into these levels.
template <class V, class W>
KV_HD V mixed(V a, V b, V c, V d, W x, W y) {
  auto const between = [](V u, V v, W w) { return product(u, 1 - w) + product(v, w); };
  return between(between(a, b, x), between(c, d, x), y);
}

}  // namespace kv
