// Where the pixels of the results of a list read before a link of a chain: the walk of composed_warp.h by one link, as
// the table of a list with all of its links is larger than the parameters of a CUDA kernel.
#pragma once

#include "geometry/transform/composed/composed_warp.h"
#include "geometry/transform/lists/remap_list.h"

namespace kv::geometry {

constexpr int kLinkPixels = 1024;  // of an item on CUDA, which is a block; on the CPU an item is some rows

template <class F>
struct LinkCoordsList {
  F const* from;             // coordinates behind the link; null: those of the pixels
  F const *matrices, *maps;  // (count, 3, 3), or a map of each sample; the other one is null
  F* to;
  int count, items;
  int height[kMaxListed], width[kMaxListed];          // of results
  int map_height[kMaxListed], map_width[kMaxListed];  // 0 for matrices
  // Where coordinates (2, h, w) and maps (2, H, W) begin in their blocks, in units.
  uint32_t coords[kMaxListed], map[kMaxListed];
  int first[kMaxListed];

  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
  KV_HD Link<F> link(int b) const {
    if (matrices) return {matrices + 9 * b, 0, 0, 0};
    return {maps + int64_t(kBlockUnit) * map[b], 0, map_height[b], map_width[b]};
  }
  KV_HD int64_t offset(int b) const { return int64_t(kBlockUnit) * coords[b]; }
};

KV_KERNEL(link_coords_list, LinkCoordsList)

}  // namespace kv::geometry
