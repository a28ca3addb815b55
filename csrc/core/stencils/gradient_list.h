// Gradients of images of different sizes, from those of the results of a function that is not linear: a sample is a
// batch of one with a plane for each channel, for which the kernels of batches are run. Included by headers of kernels.
#pragma once

#include "core/image_list.h"

namespace kv {

constexpr int kMaxListedGradients = kMaxListed / 2;  // tables have an image more for each sample

// `all` is what the samples have in common, with the parameters of all of them: a struct with images x, grad and
// grad_x, and with select(b), which leaves the parameters of sample b. The gradients of samples that are not chosen are
// copies of what is given.
template <class Gradient, class T>
struct GradientList {
  Gradient all;
  int count, items, channels;
  bool interleaved;
  float const* chosen;  // (B,), 0 for samples that are not chosen; null: all are
  int64_t chosen_stride;
  ListedImage images[kMaxListedGradients], grads[kMaxListedGradients];
  ListedResult results[kMaxListedGradients];
  int first[kMaxListedGradients];

  KV_HD bool copies(int b) const { return chosen && chosen[b * chosen_stride] == 0; }
  KV_HD int end_of(int b) const { return b + 1 < count ? first[b + 1] : items; }
  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
  KV_HD Gradient sample(int b) const {
    Gradient one = all;
    one.select(b);
    one.x = channels_of(images_of<T>(images[b], channels));
    one.grad = channels_of(images_of<T>(grads[b], channels));
    one.grad_x = channels_of(images_of<T>(results[b], channels, interleaved));
    return one;
  }
  template <class U>
  static KV_HD Planes<U> channels_of(Images<U> const& x) {
    return {x.data, x.channels, 1, x.channel_stride, 0, x.row_stride, x.height, x.width, x.step};
  }
};

// Copies row y of a plane of the given gradients: elements i, i + apart, ...
template <class Gradient>
KV_HD void copy_gradients(Gradient const& one, int64_t plane, int64_t y, int64_t i, int64_t apart) {
  auto const* const from = one.grad.row(plane, y);
  auto* const to = one.grad_x.row(plane, y);
  for (; i < one.x.width; i += apart) to[i * one.grad_x.step] = from[i * one.grad.step];
}

// On the CPU an item is some rows of all channels. Calls run(sample, first row, row behind the last), counted through
// the planes, for the items [begin, end).
template <class List, class Run>
KV_HD void gradient_items(List const& p, int64_t begin, int64_t end, Run run) {
  for (int64_t item = begin; item < end; ++item) {
    int const b = p.sample_of(int(item));
    auto const one = p.sample(b);
    int64_t const height = one.x.height, rows = rows_of_item(one.x.width), from = (item - p.first[b]) * rows,
                  to = min(from + rows, height);
    for (int64_t plane = 0; plane < p.channels; ++plane)
      if (!p.copies(b))
        run(one, plane * height + from, plane * height + to);
      else
        for (int64_t y = from; y < to; ++y) copy_gradients(one, plane, y, 0, 1);
  }
}

}  // namespace kv
