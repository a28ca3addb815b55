// Window sums of tensors: arguments checked, results allocated, kernels launched.
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

// (window sum + center * input) / divisor, or the transpose of that.
template <bool kTranspose>
Tensor run_box(char const* op, Tensor const& input, int64_t ky, int64_t kx, int64_t border, double center,
               double divisor) {
  Border const rule = to_border(op, border);
  check_box(op, input, ky, kx, rule);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Box<T> const params{planes<T const>(x, layout), planes<T>(y, layout), ky, kx, rule, F(center), F(divisor)};
    if constexpr (kTranspose) {
      KV_RUN(box_backward, x, params, params.y.rows(), params.y.row_size());
    } else {
      KV_RUN(box, x, params, params.y.rows(), params.y.row_size());
    }
  };
  if constexpr (kTranspose)
    dispatch_floating(op, x, run);
  else
    dispatch_floating_and_uint8(op, x, run);
  return y;
}

}  // namespace kv::filters
