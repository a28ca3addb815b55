// Antialiased resizing of windows of lists and its gradient, for the entries of operators. Included by
// resize_windows_list_op.cpp and augmentation/warp_and_color_op.cpp.
#pragma once

#include "geometry/transform/lists/list_glue.h"
#include "geometry/transform/lists/resize_windows_list.h"

namespace kv::geometry {

// From images to results of one size or of a size each, or from the gradients of results, one batch or a list, to those
// of images of a size each.
inline Tensors windows_resized(char const* op, Tensors const& inputs, Tensor const& matrix,
                               std::vector<int64_t> const& sides, int64_t filter, bool align_corners, bool backward) {
  KV_CHECK(!inputs.empty(), op, ": expected at least one image");
  bool const is_batch = inputs[0].dim() == 4;
  is_batch ? check_images(op, "grads", inputs[0]) : check_image_list(op, backward ? "grads" : "images", inputs);
  size_t const count = is_batch ? size_t(inputs[0].size(0)) : inputs.size();
  ListSizes const sizes(op, sides, count);
  KV_CHECK(filter >= int64_t(ResizeFilter::bilinear) && filter <= int64_t(ResizeFilter::lanczos), op,
           ": filter must be 3 (bilinear), 4 (bicubic) or 5 (lanczos), got ", filter);
  Tensor const like = is_batch ? inputs[0] : as_batch(inputs[0]);
  KV_CHECK(matches_samples(matrix, like, 3, int64_t(count)) && matrix.size(1) == 3 && matrix.size(2) == 3, op,
           ": matrix does not fit what is resized");
  Tensor const matrices = dense(matrix);
  Layout const layout = layout_of(like);
  int64_t const channels = like.size(1);
  bool const interleaved = layout == Layout::channels_last;
  Tensors const results = empty_results(like, sizes, count, layout, backward);
  if (channels == 0) return results;
  Tensors const readable = in_layout(inputs, layout);
  BatchOrList const from(readable), to(results);
  auto const run = [&]<class T>(Type<T>) {
    auto const* const data = data_ptr<Compute<T> const>(matrices);
    int64_t const stride = matrices.size(0) > 1 ? 9 : 0;
    ResizeWindowsList<T> p;
    p.all = {{}, {}, 0, ResizeFilter(filter), align_corners, backward, data, stride};
    p.channels = int(channels);
    p.list.interleaved = interleaved;
    for_each_table(
        p.list, count, [&](size_t b) { return from[b]; }, [&](size_t b) { return to[b]; },
        [&](size_t b) { return items_of_windows(channels, interleaved, sizes[b].height, sizes[b].width, backward); },
        [&](size_t first) {
          p.all.matrices = data + int64_t(first) * stride;
          KV_RUN(resize_windows_list, like, p, p.list.items, 8 * kItemPixels);
        });
  };
  if (backward)
    dispatch_floating(op, like, run);
  else
    dispatch_floating_and_uint8(op, like, run);
  return results;
}

}  // namespace kv::geometry
