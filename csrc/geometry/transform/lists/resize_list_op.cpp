// Resizing of lists of images of different sizes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/list_glue.h"
#include "geometry/transform/lists/resize_list.h"
#if defined(KV_CUDA)
#include "geometry/transform/lists/resize_windows_list_glue.h"
#endif

namespace kv::geometry {
namespace {

// From images to results of these sizes, or from the gradients of results to those of images.
Tensors resized_list(char const* op, Tensors const& inputs, std::vector<int64_t> const& sides, int64_t filter,
                     bool align_corners, bool antialias, bool backward) {
#if defined(KV_CUDA)
  // Which compute weights once for a tile, where pixels have more than two taps.
  if (antialias && filter >= int64_t(ResizeFilter::bilinear))
    return windows_resized(op, inputs, {}, sides, filter, align_corners, backward);
#endif
  ListResizing const call(op, inputs, sides, backward);
  KV_CHECK(filter >= int64_t(ResizeFilter::nearest) && filter <= int64_t(ResizeFilter::lanczos), op,
           ": filter must be 0 (nearest), 1 (nearest-exact), 2 (area), 3 (bilinear), 4 (bicubic) or 5 (lanczos), got ",
           filter);
  return call.results([&]<class T>(Type<T>, auto tables) {
    ResizeList<T> p{{}, int(call.channels), ResizeFilter(filter), align_corners, antialias, backward};
    tables(
        p.list, [&](Size size) { return items_of_resize(call.channels, call.interleaved, size.height, size.width); },
        [&](size_t) { KV_RUN(resize_list, call.like, p, p.list.items, 8 * kItemPixels); });
  });
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
