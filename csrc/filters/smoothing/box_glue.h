// Window sums of tensors: arguments checked, results allocated, kernels launched. Included by box_op.cpp and
// edges/laplacian_op.cpp.
#pragma once

#include "box.h"
#include "glue/glue.h"

namespace kv::filters {

inline void check_box(char const* op, Tensor const& x, int64_t ky, int64_t kx, Border border) {
  check_images(op, "input", x);
  check_window(op, ky, kx);
  if (x.numel() == 0) return;
  check_border(op, border, ky / 2, x.size(2));
  check_border(op, border, kx / 2, x.size(3));
}

// (window sum + center * input) / divisor.
inline Tensor box_forward(char const* op, Tensor const& input, int64_t ky, int64_t kx, int64_t border, double center,
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
inline Tensor box_backward(char const* op, Tensor const& grad, int64_t ky, int64_t kx, int64_t border, double center,
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

}  // namespace kv::filters
