// Sobel: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "sobel.h"

namespace kv::filters {
namespace {

Tensor sobel(Tensor const& input, bool normalized, double eps) {
  check_images("sobel", "input", input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout);
  ScalarType const result = x.scalar_type() == ScalarType::Byte ? ScalarType::Float : x.scalar_type();
  Tensor const y = empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x, layout, result);
  dispatch_floating_and_uint8("sobel", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Sobel<T> const params{planes<T const>(x, layout), planes<DerivativeOf<T>>(y, layout), F(normalized ? 0.125 : 1),
                          F(eps)};
    KV_RUN(sobel, x, params, params.y.rows(), params.y.row_size());
  });
  return y;
}

Tensor sobel_backward(Tensor const& grad, Tensor const& input, bool normalized, double eps) {
  check_images("sobel_backward", "input", input);
  check_like("sobel_backward", "grad", grad, input);
  Layout const layout = layout_of(input);
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout), grad_x = empty_like(x, layout);
  dispatch_floating("sobel_backward", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SobelBackward<T> const params{planes<T const>(g, layout), planes<T const>(x, layout), planes<T>(grad_x, layout),
                                  F(normalized ? 0.125 : 1), F(eps)};
    KV_RUN(sobel_backward, x, params, params.x.rows(), params.x.row_size());
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(sobel, "(Tensor input, bool normalized, float eps) -> Tensor")
KV_OPERATOR(sobel_backward, "(Tensor grad, Tensor input, bool normalized, float eps) -> Tensor")

}  // namespace kv::filters
