// Lists of images of different sizes whose channels are reduced to statistics, on the CPU. Included by *_cpu.cpp files.
#pragma once

#include "core/stencils/filter_list.h"

namespace kv {

// An item is all pixels of a channel. Calls run(sample, first channel, channel behind the last) for the items
// [begin, end).
template <class List, class Run>
KV_HD void channel_items(List const& p, int64_t begin, int64_t end, Run run) {
  while (begin < end) {
    int const b = p.list.sample_of(int(begin));
    auto const one = p.sample(b);
    int64_t const first = p.list.first[b], last = min(end, first + p.channels), step = one.x.step;
    if (p.copies(b)) {
      for (int64_t c = begin - first; c < last - first; ++c)
        for (int64_t y = 0, plane = step > 1 ? 0 : c, at = step > 1 ? c : 0; y < one.y.height; ++y)
          for (int64_t x = 0; x < one.y.width; ++x)
            one.y.row(plane, y)[x * step + at] = one.x.row(plane, y)[x * step + at];
    } else {
      run(one, begin - first, last - first);
    }
    begin = last;
  }
}

}  // namespace kv
