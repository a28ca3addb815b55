// Tables of maps of lists, for the entries of operators.
#pragma once

#include "augmentation/lists/listed_maps.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {

// Maps (2, H, W) of a size each, one after the other in one tensor.
struct MapBlock {
  char const* op;
  int64_t count;
  std::vector<int64_t> const& sides;
  std::vector<int64_t> begins;

  MapBlock(char const* op, int64_t count, std::vector<int64_t> const& sides) : op(op), count(count), sides(sides) {
    KV_CHECK(int64_t(sides.size()) == 2 * count, op, ": expected height and width of ", count, " maps");
    begins = geometry::offsets_in_block(2, {op, sides, size_t(count)}, size_t(count));
    KV_CHECK(begins.back() / kMapUnit <= UINT32_MAX, op, ": expected smaller maps");
  }
  Tensor empty_like(Tensor const& like) const { return empty({begins.back()}, like); }

  // Fills tables, whose items are rows of maps, and calls run(first map of the table).
  template <class Run>
  void for_each_table(ListedMaps& list, Run run) const {
    for (int64_t first = 0; first < count; first += kMaxListedMaps) {
      list.count = int(std::min(count - first, int64_t(kMaxListedMaps)));
      int64_t items = 0;
      for (int i = 0; i < list.count; ++i) {
        size_t const b = size_t(first + i);
        list.height[i] = int(sides[2 * b]), list.width[i] = int(sides[2 * b + 1]);
        list.begin[i] = uint32_t(begins[b] / kMapUnit);
        list.first[i] = int(items);
        items += ceil_div(sides[2 * b], rows_of_item(sides[2 * b + 1]));
        KV_CHECK(items <= INT32_MAX, op, ": expected smaller maps");
      }
      list.items = int(items);
      run(first);
    }
  }
};

}  // namespace kv::augmentation
