// Resizing of lists of images of different sizes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/list_glue.h"
#include "geometry/transform/lists/resize_list.h"

namespace kv::geometry {
namespace {

// From images to results of these sizes, or from the gradients of results to those of images.
Tensors resized_list(char const* op, Tensors const& inputs, std::vector<int64_t> const& sides, int64_t filter,
                     bool align_corners, bool antialias, bool backward) {
  KV_CHECK(!inputs.empty(), op, ": expected at least one image");
  bool const is_batch = inputs[0].dim() == 4;
  is_batch ? check_images(op, "grads", inputs[0]) : check_image_list(op, backward ? "grads" : "images", inputs);
  size_t const count = is_batch ? size_t(inputs[0].size(0)) : inputs.size();
  ListSizes const sizes(op, sides, count);
  KV_CHECK(filter >= int64_t(ResizeFilter::nearest) && filter <= int64_t(ResizeFilter::lanczos), op,
           ": filter must be 0 (nearest), 1 (nearest-exact), 2 (area), 3 (bilinear), 4 (bicubic) or 5 (lanczos), got ",
           filter);
  Tensor const like = is_batch ? inputs[0] : as_batch(inputs[0]);
  Layout const layout = layout_of(like);
  int64_t const channels = like.size(1);
  bool const interleaved = layout == Layout::channels_last;
  Tensors const results = empty_results(like, sizes, count, layout, backward);
  if (channels == 0) return results;

  Tensors const readable = in_layout(inputs, layout);
  BatchOrList const from(readable), to(results);
  auto const run = [&]<class T>(Type<T>) {
    ResizeList<T> p{{}, int(channels), ResizeFilter(filter), align_corners, antialias, backward};
    p.list.interleaved = interleaved;
    for_each_table(
        p.list, count, [&](size_t b) { return from[b]; }, [&](size_t b) { return to[b]; },
        [&](size_t b) { return items_of_resize(channels, interleaved, sizes[b].height, sizes[b].width); },
        [&](size_t) { KV_RUN(resize_list, like, p, p.list.items, 8 * kItemPixels); });
  };
  if (backward)
    dispatch_floating(op, like, run);
  else
    dispatch_floating_and_uint8(op, like, run);
  return results;
}

Tensors resize_list(Tensors const& images, std::vector<int64_t> const& size, int64_t filter, bool align_corners,
                    bool antialias) {
  return resized_list("resize_list", images, size, filter, align_corners, antialias, false);
}

Tensors resize_list_backward(Tensors const& grads, std::vector<int64_t> const& size, int64_t filter, bool align_corners,
                             bool antialias) {
  return resized_list("resize_list_backward", grads, size, filter, align_corners, antialias, true);
}

}  // namespace

#define KV_RESIZE_LIST_OPTIONS "SymInt[] size, int filter, bool align_corners, bool antialias) -> Tensor[]"
// `images` (C, H, W) of different sizes. `size` is one height and width, of a result (B, C, h, w), or those of a list
// of results.
KV_OPERATOR(resize_list, "(Tensor[] images, " KV_RESIZE_LIST_OPTIONS)
// `size` has height and width of each image. The gradients are one tensor (B, C, h, w), or one of each result.
KV_OPERATOR(resize_list_backward, "(Tensor[] grads, " KV_RESIZE_LIST_OPTIONS)
#undef KV_RESIZE_LIST_OPTIONS

}  // namespace kv::geometry
