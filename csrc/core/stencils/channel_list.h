// Lists of images of different sizes whose channels are processed by themselves. Included by headers of such operators.
#pragma once

#include "core/stencils/filter_list.h"

namespace kv {

// A plane for each channel, also of interleaved pixels.
template <class T>
KV_HD void by_channels(Planes<T>& p) {
  if (p.step > 1) p.inner = p.step, p.inner_stride = 1;
}

// A sample, whose rows follow each other, with each channel as one row.
template <class T>
KV_HD Planes<T> flat_channels(Planes<T> p) {
  by_channels(p);
  p.width *= p.height, p.height = 1;
  p.row_stride = p.row_size();
  return p;
}
template <class Filter>
KV_HD Filter flat_sample(Filter one) {
  one.x = flat_channels(one.x), one.y = flat_channels(one.y);
  return one;
}

// On the CPU an item is all pixels of a channel. Calls run(sample, first channel, channel behind the last) for the
// items [begin, end).
template <class List, class Run>
KV_HD void channel_items(List const& p, int64_t begin, int64_t end, Run run) {
  while (begin < end) {
    int const b = p.list.sample_of(int(begin));
    auto one = p.sample(b);
    by_channels(one.x), by_channels(one.y);
    int64_t const first = p.list.first[b], last = min(end, first + p.channels), step = one.x.step;
    if (p.copies(b)) {
      for (int64_t c = begin - first; c < last - first; ++c)
        for (int64_t y = 0; y < one.y.height; ++y)
          for (int64_t x = 0; x < one.y.width; ++x) one.y.row(c, y)[x * step] = one.x.row(c, y)[x * step];
    } else {
      run(one, begin - first, last - first);
    }
    begin = last;
  }
}

}  // namespace kv
