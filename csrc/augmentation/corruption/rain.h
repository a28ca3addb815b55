// Lines of rain: where drops of a size are, from their positions. corruption/rain.py of kvision.augmentation defines
// them.
#pragma once

#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

// T is the type of positions, float.
template <class T>
struct RainMask {
  int64_t const* drops;  // (B, 3): their number, their height, and their width, below 0 where they lean to the left
  T const* positions;    // (B, N, 2): down and to the right, as fractions of where drops may begin
  uint8_t* y;            // (B, tall, wide), 0 or 1, of which images have the upper left part
  int64_t batch, most, height, width, tall, wide, longest;  // pixels of a drop at most

  // A sample as a batch of one.
  KV_HD RainMask sample(int64_t b) const {
    RainMask one = *this;
    one.drops += 3 * b;
    one.positions += 2 * b * most;
    one.y += b * tall * wide;
    one.batch = 1;
    return one;
  }
};

// The same of images of different sizes.
template <class T>
struct RainMaskList {
  RainMask<T> all;
  struct Size {
    int height, width;
  } sizes[kMaxListed];

  KV_HD RainMask<T> sample(int64_t b) const {
    RainMask<T> one = all.sample(b);
    one.height = sizes[b].height, one.width = sizes[b].width;
    return one;
  }
};

KV_KERNEL(rain_mask, RainMask)
KV_KERNEL(rain_mask_list, RainMaskList)

// The drops of a batch of one.
struct Rain {
  int64_t count, down, right, across, steps, rows, columns, left;
  int64_t height, width, row_stride;

  template <class T>
  KV_HD explicit Rain(RainMask<T> const& p) : height(p.height), width(p.width), row_stride(p.wide) {
    int64_t const *const own = p.drops, tall = own[1], wide = own[2];
    // Extents from the first pixel of a drop to its last one; all of a drop is in the image.
    count = min(own[0], p.most), down = tall - 1, right = wide - (wide > 0) + (wide < 0);
    across = right < 0 ? -right : right;
    steps = min(max(tall, wide < 0 ? -wide : wide), p.longest) - 1;
    rows = height - down, columns = width - across, left = right < 0 ? -right : 0;
  }
  // Marks the pixels of a drop, of its position.
  template <class T>
  KV_HD void mark(T const* position, uint8_t* y) const {
    int64_t const top = min(int64_t(position[0] * T(rows)), rows - 1),
                  first = min(int64_t(position[1] * T(columns)), columns - 1) + left;
    int64_t const parts = max(steps, int64_t(1));
    for (int64_t k = 0; k <= steps; ++k) {
      int64_t const row = top + k * down / parts, step = k * across / parts,
                    column = first + (right < 0 ? -step : step);
      if (row >= 0 && row < height && column >= 0 && column < width) y[row * row_stride + column] = 1;
    }
  }
};

}  // namespace kv::augmentation
