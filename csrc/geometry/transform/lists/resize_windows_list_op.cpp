// Antialiased resizing of windows of lists: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/resize_windows_list_glue.h"

namespace kv::geometry {
namespace {

Tensors resize_windows_list(Tensors const& images, Tensor const& matrix, std::vector<int64_t> const& size,
                            int64_t filter, bool align_corners) {
  return windows_resized("resize_windows_list", images, matrix, size, filter, align_corners, false);
}

Tensors resize_windows_list_backward(Tensors const& grads, Tensor const& matrix, std::vector<int64_t> const& size,
                                     int64_t filter, bool align_corners) {
  return windows_resized("resize_windows_list_backward", grads, matrix, size, filter, align_corners, true);
}

}  // namespace

#define KV_WINDOW_LIST_OPTIONS "Tensor matrix, SymInt[] size, int filter, bool align_corners) -> Tensor[]"
// `images` (C, H, W) of different sizes, a matrix (B, 3, 3) of each as `resize_windows` takes it. `size` is one height
// and width, of a result (B, C, h, w), or those of a list of results.
KV_OPERATOR(resize_windows_list, "(Tensor[] images, " KV_WINDOW_LIST_OPTIONS)
// `size` has height and width of each image. The gradients are one tensor (B, C, h, w), or one of each result.
KV_OPERATOR(resize_windows_list_backward, "(Tensor[] grads, " KV_WINDOW_LIST_OPTIONS)
#undef KV_WINDOW_LIST_OPTIONS

}  // namespace kv::geometry
