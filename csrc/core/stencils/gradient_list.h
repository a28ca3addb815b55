// Gradients of images of different sizes, from those of the results of a function that is not linear: a sample is a
// batch of one, for which the kernels of batches are run. Included by headers of kernels.
#pragma once

#include "core/stencils/channel_list.h"

namespace kv {

constexpr int kMaxListedGradients = kMaxListed / 2;  // tables have an image more for each sample

// `all` is what the samples have in common, with the parameters of all of them: a struct with images x, grad and
// grad_x, and with select(b), which leaves the parameters of sample b. The gradients of samples that are not chosen are
// copies of what is given. A sample has a plane for each channel; `AsStored`, interleaved pixels are one plane, as
// batches have them.
template <class Gradient, class T, bool AsStored = false>
struct GradientList {
  static constexpr bool kAsStored = AsStored;
  Gradient all;
  int count, items, channels;
  bool interleaved;
  float const* chosen;  // (B,), 0 for samples that are not chosen; null: all are
  int64_t chosen_stride;
  ListedImage images[kMaxListedGradients], grads[kMaxListedGradients];
  ListedResult results[kMaxListedGradients];
  int first[kMaxListedGradients];

  KV_HD bool copies(int b) const { return chosen && chosen[b * chosen_stride] == 0; }
  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
  KV_HD Gradient sample(int b) const {
    Gradient one = all;
    one.select(b);
    one.x = planes(images_of<T>(images[b], channels));
    one.grad = planes(images_of<T>(grads[b], channels));
    one.grad_x = planes(images_of<T>(results[b], channels, interleaved));
    return one;
  }
  template <class U>
  KV_HD Planes<U> planes(Images<U> const& x) const {
    if constexpr (AsStored) return planes_of(x, interleaved);
    return {x.data, x.channels, 1, x.channel_stride, 0, x.row_stride, x.height, x.width, x.step};
  }
};

// Copies row y of a plane of the given gradients: elements i, i + apart, ...
template <bool AsStored, class Gradient>
KV_HD void copy_gradients(Gradient const& one, int64_t plane, int64_t y, int64_t i, int64_t apart) {
  auto const* const from = one.grad.row(plane, y);
  auto* const to = one.grad_x.row(plane, y);
  if constexpr (AsStored)
    for (; i < one.x.row_size(); i += apart) to[i] = from[i];
  else
    for (; i < one.x.width; i += apart) to[i * one.grad_x.step] = from[i * one.grad.step];
}

// On the CPU an item is some rows of all planes. Calls run(sample, first row, row behind the last), counted through
// the planes, for the items [begin, end).
template <class List, class Run>
KV_HD void gradient_items(List const& p, int64_t begin, int64_t end, Run run) {
  for (int64_t item = begin; item < end; ++item) {
    int const b = p.sample_of(int(item));
    auto const one = p.sample(b);
    int64_t const height = one.x.height, rows = rows_of_item(one.x.width), from = (item - p.first[b]) * rows,
                  to = min(from + rows, height);
    for (int64_t plane = 0; plane < one.x.count(); ++plane)
      if (!p.copies(b))
        run(one, plane * height + from, plane * height + to);
      else
        for (int64_t y = from; y < to; ++y) copy_gradients<List::kAsStored>(one, plane, y, 0, 1);
  }
}

// A sample as it is stored, whose rows follow each other, with each channel as one row.
template <class Gradient>
KV_HD Gradient flat_gradients(Gradient one) {
  one.x = flat_channels(one.x), one.grad = flat_channels(one.grad), one.grad_x = flat_channels(one.grad_x);
  return one;
}

// The same where an item is all pixels of a channel: calls run(flat sample, first channel, channel behind the last).
template <class List, class Run>
KV_HD void channel_gradient_items(List const& p, int64_t begin, int64_t end, Run run) {
  for_each_sample(p, begin, end, [&](int b, int64_t first, int64_t last) KV_INLINE {
    auto const one = flat_gradients(p.sample(b));
    if (p.copies(b))
      for (int64_t c = first; c < last; ++c) copy_gradients<false>(one, c, 0, 0, 1);
    else
      run(one, first, last);
  });
}

}  // namespace kv
