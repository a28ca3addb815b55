// Antialiased resizing of windows: schemas and entries, for CPU and CUDA.
#include "geometry/transform/resize/resize_windows_glue.h"

namespace kv::geometry {
namespace {

Tensor resize_windows(Tensor const& input, Tensor const& matrix, std::vector<int64_t> size, int64_t filter,
                      bool align_corners) {
  return windows_resized("resize_windows", input, matrix, size, filter, align_corners, false);
}

Tensor resize_windows_backward(Tensor const& grad, Tensor const& matrix, std::vector<int64_t> size, int64_t filter,
                               bool align_corners) {
  return windows_resized("resize_windows_backward", grad, matrix, size, filter, align_corners, true);
}

// Views of each image: result v * B + b is the window `boxes[b, v]` of image b.
Tensor resize_views(Tensor const& input, Tensor const& boxes, std::vector<int64_t> sides, int64_t filter) {
  constexpr char const* op = "resize_views";
  check_images(op, "input", input);
  Size const size = checked_size(op, sides);
  checked_size(op, input);
  check_window_filter(op, filter);
  KV_CHECK(boxes.dim() == 3 && boxes.size(0) == input.size(0) && boxes.size(2) >= 4 && boxes.stride(2) == 1 &&
               boxes.device() == input.device() && boxes.scalar_type() == compute_dtype(input),
           op, ": expected boxes of shape (B, V, 4), of the type that computes, on the device of the images");
  KV_CHECK(boxes.size(0) * boxes.size(1) <= INT32_MAX, op, ": expected fewer views");
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout);
  int64_t const images = x.size(0), samples = images * boxes.size(1);
  Tensor const y = empty({samples, x.size(1), size.height, size.width}, x, layout);
  run_windows(op, x, y, layout, filter, false, false, [&]<class T>(ResizeWindows<T>& p) {
    p.boxes = data_ptr<Compute<T> const>(boxes);
    p.images = images, p.box_image_stride = boxes.stride(0), p.box_view_stride = boxes.stride(1);
    p.views = unsigned(boxes.size(1));
  });
  return y;
}

}  // namespace

#define KV_WINDOW_OPTIONS "Tensor matrix, SymInt[] size, int filter, bool align_corners"
// `matrix` (B, 3, 3), without rotation and shear, maps pixels of the images to those of the results.
KV_OPERATOR(resize_windows, "(Tensor input, " KV_WINDOW_OPTIONS ") -> Tensor")
KV_OPERATOR(resize_windows_backward, "(Tensor grad, " KV_WINDOW_OPTIONS ") -> Tensor")
#undef KV_WINDOW_OPTIONS
KV_OPERATOR(resize_views, "(Tensor input, Tensor boxes, SymInt[] size, int filter) -> Tensor")

}  // namespace kv::geometry
