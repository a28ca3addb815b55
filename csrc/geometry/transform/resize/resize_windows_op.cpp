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

}  // namespace

#define KV_WINDOW_OPTIONS "Tensor matrix, SymInt[] size, int filter, bool align_corners"
// `matrix` (B, 3, 3), without rotation and shear, maps pixels of the images to those of the results.
KV_OPERATOR(resize_windows, "(Tensor input, " KV_WINDOW_OPTIONS ") -> Tensor")
KV_OPERATOR(resize_windows_backward, "(Tensor grad, " KV_WINDOW_OPTIONS ") -> Tensor")
#undef KV_WINDOW_OPTIONS

}  // namespace kv::geometry
