// Traverses the rows of planes on the CPU for stencils whose intermediate rows are computed once and kept.
#pragma once

#include "hd.h"

namespace kv {

// Calls row(plane, y, r) for rows [begin, end) of all planes in order. Before it, fill(plane, y) has been called for
// the rows y - 1, y and y + 1, in order and once each; rows out of bounds are included.
template <class Fill, class Row>
KV_HD void stream_rows(int64_t begin, int64_t end, int64_t height, Fill const& fill, Row const& row) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    if (r == begin || y == 0) {
      fill(plane, y - 1);
      fill(plane, y);
    }
    fill(plane, y + 1);
    row(plane, y, r);
  }
}

}  // namespace kv
