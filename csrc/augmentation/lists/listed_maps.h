// Tables of maps (2, H, W) of lists of images of different sizes, in one block of memory. Included by headers of
// kernels that make maps.
#pragma once

#include "core/image_list.h"

namespace kv::augmentation {

// Each begins at a multiple of so many elements.
constexpr int kMapUnit = 16;

// The channels of images may have a map each.
constexpr int kMaxListedMaps = 3 * kMaxListed;

// A kernel's work is a number of items, parts of a map; those of map b begin at first[b].
struct ListedMaps {
  int count, items;
  int height[kMaxListedMaps], width[kMaxListedMaps], first[kMaxListedMaps];
  uint32_t begin[kMaxListedMaps];  // in units

  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
};

}  // namespace kv::augmentation
