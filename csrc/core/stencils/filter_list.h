// Filters of lists of images of different sizes, whose results have the sizes of the images: a sample is a batch of
// one, for which the kernels of batches are run. Included by headers of filters.
#pragma once

#include "core/image_list.h"

namespace kv {

// `all` is what the samples have in common, with the parameters of all of them: a struct with images x and y, and with
// select(b), which leaves the parameters of sample b. One with fit_windows() has windows that follow from the images.
// Samples that are not chosen are copied.
template <class Filter, class T>
struct FilterList {
  Filter all;
  ListedSamples list;
  float const* chosen;  // (B,), 0 for samples that are not chosen; null: all are
  int64_t chosen_stride;
  int channels;

  KV_HD bool copies(int b) const { return chosen && chosen[b * chosen_stride] == 0; }
  KV_HD Filter sample(int b) const {
    Filter one = all;
    one.select(b);
    one.x = planes_of(images_of<T>(list.images[b], channels), list.interleaved);
    one.y = planes_of(images_of<T>(list.results[b], channels, list.interleaved), list.interleaved);
    if constexpr (requires { one.fit_windows(); }) one.fit_windows();
    return one;
  }
};

// On the CPU an item is some rows of the planes of a sample. Calls run(sample, first row, row behind the last) for the
// items [begin, end).
template <class List, class Run>
KV_HD void filter_items(List const& p, int64_t begin, int64_t end, Run run) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) KV_INLINE {
    auto const one = p.sample(b);
    int64_t const height = one.y.height, rows = rows_of_item(one.y.width);
    int64_t const from = first * rows, to = min(last * rows, one.y.rows());
    if (p.copies(b)) {
      for (int64_t r = from; r < to; ++r)
        __builtin_memcpy(one.y.row(r / height, r % height), one.x.row(r / height, r % height),
                         uint64_t(one.y.row_size()) * sizeof(*one.y.data));
    } else {
      run(one, from, to);
    }
  });
}

}  // namespace kv
