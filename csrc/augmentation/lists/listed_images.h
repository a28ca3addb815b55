// Operators on lists of images of different sizes that change the images which are chosen, for their entries.
#pragma once

#include "augmentation/lists/list_steps.h"
#include "augmentation/noise_glue.h"
#include "color/lists/program_list_glue.h"
#include "core/stencils/filter_list.h"
#include "core/stencils/gradient_list.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {

// Images (C, H, W), and which of them are changed, (B,) float32; the others are copied.
struct ListedImages {
  geometry::KeptSizes kept;
  OptionalTensor const& chosen;
  Tensors images;  // in the layout of the results

  // `dense`: those are copied, too, whose rows do not follow each other. `in_block`: as KeptSizes has it.
  ListedImages(char const* op, Tensors const& images, OptionalTensor const& chosen, bool dense = false,
               bool in_block = false)
      : kept(op, images, in_block),
        chosen(chosen),
        images(dense ? color::in_pixel_rows(images, kept.layout) : geometry::in_layout(images, kept.layout)) {
    check_chosen(op, chosen, like());
  }
  // The gradients of the results, or these, in the layout of the images.
  Tensors in_layout_of_images(Tensors const& grads, bool dense = false) const {
    for (size_t b = 0; b < images.size(); ++b) check_like(kept.op, "a gradient", grads[b], images[b]);
    return dense ? color::in_pixel_rows(grads, kept.layout) : geometry::in_layout(grads, kept.layout);
  }
  // Results of the forward pass, of which those are copied that are not stored as the results are here.
  Tensors as_results(Tensors const& given) const {
    KV_CHECK(given.size() == images.size(), kept.op, ": expected a result of each image");
    return in_layout_of_images(given, true);
  }
  // Stands for a batch in checks.
  Tensor const& like() const { return kept.largest; }
  int64_t channels() const { return like().size(1); }
  int64_t planes() const { return kept.interleaved() ? 1 : channels(); }

  void check_window_fits(Border border, int64_t ky, int64_t kx) const {
    check_window(kept.op, ky, kx);
    for (Tensor const& x : images) {
      check_border(kept.op, border, ky / 2, x.size(1));
      check_border(kept.op, border, kx / 2, x.size(2));
    }
  }

  // Runs a filter, `all` without images, on tables of at most kMaxListed samples: run(table, cost of an item).
  template <class List, class Filter, class Run>
  void filter(Filter const& all, int64_t cost_of_pixel, Run run) const {
    auto const items_of = [&](geometry::Size size) {
      return ceil_div(planes() * size.height, rows_of_item(size.width));
    };
    for_each_table<List>(all, items_of, [&](List& list) {
      run(list, cost_of_pixel * max(kItemPixels, like().size(3)) * channels() / planes());
    });
  }
  // The same where an item is all pixels of a channel.
  template <class List, class Filter, class Run>
  void filter_channels(Filter const& all, int64_t cost_of_pixel, Run run) const {
    for_each_table<List>(
        all, [&](geometry::Size) { return channels(); },
        [&](List& list) { run(list, cost_of_pixel * like().size(2) * like().size(3)); });
  }
  // Runs the gradient of a function, `all` without images, on tables of images and of `grads`, which have the layout:
  // run(table, first sample of the table, cost of an item).
  template <class List, class Gradient, class Run>
  void gradients(Gradient const& all, Tensors const& grads, int64_t cost_of_pixel, Run run) const {
    auto const items_of = [](Tensor const& x) { return ceil_div(x.size(1), rows_of_item(x.size(2))); };
    for_each_gradient_table<List>(
        all, grads, items_of, [&](List& p, size_t first) { run(p, first, cost_of_pixel * kItemPixels * p.channels); });
  }
  // The same where an item is all pixels of a channel.
  template <class List, class Gradient, class Run>
  void channel_gradients(Gradient const& all, Tensors const& grads, int64_t cost_of_pixel, Run run) const {
    for_each_gradient_table<List>(
        all, grads, [&](Tensor const&) { return channels(); },
        [&](List& p, size_t) { run(p, cost_of_pixel * like().size(2) * like().size(3)); });
  }
  // The same where items_of(image) says how many items it has: run(table, first sample of the table).
  template <class List, class Gradient, class ItemsOf, class Run>
  void for_each_gradient_table(Gradient const& all, Tensors const& grads, ItemsOf items_of, Run run) const {
    List p{};
    p.channels = int(channels());
    p.interleaved = kept.interleaved();
    p.chosen_stride = chosen && chosen->size(0) > 1 ? chosen->stride(0) : 0;
    for (size_t begin = 0; begin < images.size() && p.channels > 0; begin += kMaxListedGradients) {
      p.count = int(std::min(images.size() - begin, size_t(kMaxListedGradients)));
      p.items = 0;
      for (int i = 0; i < p.count; ++i) {
        Tensor const &x = images[begin + size_t(i)], &y = kept.results[begin + size_t(i)];
        p.images[i] = listed(x);
        p.grads[i] = listed(grads[begin + size_t(i)]);
        p.results[i] = {y.mutable_data_ptr(), int(y.size(1)), int(y.size(2))};
        p.first[i] = p.items;
        p.items += int(items_of(x));
      }
      p.all = all;
      p.all.select(int64_t(begin));
      p.chosen = chosen ? data_ptr<float const>(*chosen) + int64_t(begin) * p.chosen_stride : nullptr;
      run(p, begin);
    }
  }
  // The same where items_of(size) says how many items an image has: run(table).
  template <class List, class Filter, class ItemsOf, class Run>
  void for_each_table(Filter const& all, ItemsOf items_of, Run run) const {
    List list;
    kept.for_each_table(list.list, images, items_of, [&](size_t first) {
      list.all = all;
      list.all.select(int64_t(first));
      list.chosen_stride = chosen && chosen->size(0) > 1 ? chosen->stride(0) : 0;
      list.chosen = chosen ? data_ptr<float const>(*chosen) + int64_t(first) * list.chosen_stride : nullptr;
      list.channels = int(channels());
      run(list);
    });
  }
};

}  // namespace kv::augmentation
