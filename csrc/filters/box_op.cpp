// Box blur and the box Laplacian: schemas and entries, for CPU and CUDA alike.
#include "box.h"
#include "glue/glue.h"

namespace kv::filters {
namespace {

void check_box(char const* op, Tensor const& x, int64_t ky, int64_t kx, Border border) {
  check_images(op, "input", x);
  check_window(op, ky, kx);
  if (x.numel() == 0) return;
  check_border(op, border, ky / 2, x.size(2));
  check_border(op, border, kx / 2, x.size(3));
}

// (window sum + center * input) / divisor.
Tensor box_forward(char const* op, Tensor const& input, int64_t ky, int64_t kx, int64_t border, double center,
                   double divisor) {
  Border const rule = to_border(op, border);
  check_box(op, input, ky, kx, rule);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Box<T> const params{planes<T const>(x, layout), planes<T>(y, layout), ky, kx, rule, F(center), F(divisor)};
    KV_RUN(box, x, params, params.y.rows(), params.y.row_size());
  });
  return y;
}

// The transpose of box_forward.
Tensor box_backward(char const* op, Tensor const& grad, int64_t ky, int64_t kx, int64_t border, double center,
                    double divisor) {
  Border const rule = to_border(op, border);
  check_box(op, grad, ky, kx, rule);
  Layout const layout = layout_of(grad);
  Tensor const g = as_layout(grad, layout), grad_x = empty_like(g, layout);
  dispatch_floating(op, g, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Box<T> const params{planes<T const>(g, layout), planes<T>(grad_x, layout), ky, kx, rule, F(center), F(divisor)};
    KV_RUN(box_backward, g, params, params.y.rows(), params.y.row_size());
  });
  return grad_x;
}

Tensor box_blur(Tensor const& input, int64_t ky, int64_t kx, int64_t border) {
  return box_forward("box_blur", input, ky, kx, border, 0, double(ky) * double(kx));
}

Tensor box_blur_backward(Tensor const& grad, int64_t ky, int64_t kx, int64_t border) {
  return box_backward("box_blur_backward", grad, ky, kx, border, 0, double(ky) * double(kx));
}

// Ones with 1 - n in the center; the sum of their magnitudes is 2 (n - 1).
double laplacian_divisor(int64_t ky, int64_t kx, bool normalized) {
  return normalized ? 2 * (double(ky) * double(kx) - 1) : 1;
}

Tensor laplacian(Tensor const& input, int64_t ky, int64_t kx, bool normalized, int64_t border) {
  return box_forward("laplacian", input, ky, kx, border, -double(ky) * double(kx),
                     laplacian_divisor(ky, kx, normalized));
}

Tensor laplacian_backward(Tensor const& grad, int64_t ky, int64_t kx, bool normalized, int64_t border) {
  return box_backward("laplacian_backward", grad, ky, kx, border, -double(ky) * double(kx),
                      laplacian_divisor(ky, kx, normalized));
}

}  // namespace

KV_OPERATOR(box_blur, "(Tensor input, int ky, int kx, int border) -> Tensor")
KV_OPERATOR(box_blur_backward, "(Tensor grad, int ky, int kx, int border) -> Tensor")
KV_OPERATOR(laplacian, "(Tensor input, int ky, int kx, bool normalized, int border) -> Tensor")
KV_OPERATOR(laplacian_backward, "(Tensor grad, int ky, int kx, bool normalized, int border) -> Tensor")

}  // namespace kv::filters
