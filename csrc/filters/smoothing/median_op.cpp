// Median blur: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "median.h"

namespace kv::filters {
namespace {

Border checked_border(char const* op, Tensor const& x, int64_t ky, int64_t kx, int64_t border_mode) {
  check_window(op, ky, kx);
  Border const border = to_border(op, border_mode);
  check_border(op, border, median_after(ky), x.size(2));
  check_border(op, border, median_after(kx), x.size(3));
  return border;
}

Tensor median_blur(Tensor const& input, int64_t ky, int64_t kx, int64_t border_mode) {
  check_images("median_blur", "input", input);
  Border const border = checked_border("median_blur", input, ky, kx, border_mode);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8("median_blur", x, [&](auto type) {
    using T = typename decltype(type)::type;
    MedianBlur<T> const params{planes<T const>(x, layout), planes<T>(y, layout), ky, kx, border};
    KV_RUN(median_blur, x, params, params.y.rows(), params.y.row_size() * ky * kx / 4);
  });
  return y;
}

Tensor median_blur_backward(Tensor const& grad, Tensor const& input, Tensor const& output, int64_t ky, int64_t kx,
                            int64_t border_mode) {
  check_images("median_blur_backward", "input", input);
  check_like("median_blur_backward", "grad", grad, input);
  check_like("median_blur_backward", "output", output, input);
  Border const border = checked_border("median_blur_backward", input, ky, kx, border_mode);
  Layout const layout = layout_of(input);
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout), y = as_layout(output, layout),
               grad_x = empty_like(x, layout);
  dispatch_floating("median_blur_backward", x, [&](auto type) {
    using T = typename decltype(type)::type;
    MedianBlurBackward<T> const params{planes<T const>(g, layout),
                                       planes<T const>(x, layout),
                                       planes<T const>(y, layout),
                                       planes<T>(grad_x, layout),
                                       ky,
                                       kx,
                                       border};
    KV_RUN(median_blur_backward, x, params, params.x.rows(), params.x.row_size() * ky * kx / 4);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(median_blur, "(Tensor input, int ky, int kx, int border) -> Tensor")
KV_OPERATOR(median_blur_backward, "(Tensor grad, Tensor input, Tensor output, int ky, int kx, int border) -> Tensor")

}  // namespace kv::filters
