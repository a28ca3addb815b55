// Walking down the planes of an image on the CPU, for results that need what the rows above and below give.
#pragma once

#include "hd.h"

namespace kv {

// For rows [begin, end) of all planes in order, as `height` has them: row(plane, y, r) for each, before which
// fill(plane, y) was called for it and its neighbours, in order and once each, also for those outside of the plane.
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
