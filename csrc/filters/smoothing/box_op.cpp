// Box blur: schemas and entries, for CPU and CUDA.
#include "box_glue.h"

namespace kv::filters {
namespace {

Tensor box_blur(Tensor const& input, int64_t ky, int64_t kx, int64_t border) {
  return run_box<false>("box_blur", input, ky, kx, border, 0, double(ky) * double(kx));
}

Tensor box_blur_backward(Tensor const& grad, int64_t ky, int64_t kx, int64_t border) {
  return run_box<true>("box_blur_backward", grad, ky, kx, border, 0, double(ky) * double(kx));
}

}  // namespace

KV_OPERATOR(box_blur, "(Tensor input, int ky, int kx, int border) -> Tensor")
KV_OPERATOR(box_blur_backward, "(Tensor grad, int ky, int kx, int border) -> Tensor")

}  // namespace kv::filters
