// Derivatives of an image: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "spatial_gradient.h"

namespace kv::filters {
namespace {

DerivativeKind derivative_kind(char const* op, int64_t mode, int64_t order) {
  bool const sobel = mode == int64_t(DerivativeMode::sobel);
  KV_CHECK(sobel || mode == int64_t(DerivativeMode::diff), op, ": mode must be 0 (sobel) or 1 (diff), got ", mode);
  KV_CHECK(order == 1 || order == 2, op, ": order must be 1 or 2; got ", order);
  if (sobel) return order == 1 ? DerivativeKind::sobel1 : DerivativeKind::sobel2;
  return order == 1 ? DerivativeKind::diff1 : DerivativeKind::diff2;
}

Tensor spatial_gradient(Tensor const& input, int64_t mode, int64_t order, bool normalized) {
  check_images("spatial_gradient", "input", input);
  DerivativeKind const kind = derivative_kind("spatial_gradient", mode, order);
  int64_t const b = input.size(0), c = input.size(1), h = input.size(2), w = input.size(3);
  Tensor const x = as_layout(input, Layout::planar);
  ScalarType const result = x.scalar_type() == ScalarType::Byte ? ScalarType::Float : x.scalar_type();
  Tensor const y = empty({b, c, order + 1, h, w}, x, Layout::planar, result);
  dispatch_floating_and_uint8("spatial_gradient", x, [&](auto type) {
    using T = typename decltype(type)::type;
    SpatialGradient<T> const params{planes<T const>(x, Layout::planar), stacked_planes<DerivativeOf<T>>(y), kind,
                                    normalized};
    KV_RUN(spatial_gradient, x, params, params.x.rows(), w * (order + 2));
  });
  return y;
}

Tensor spatial_gradient_backward(Tensor const& grad, int64_t mode, int64_t order, bool normalized) {
  check_volumes("spatial_gradient_backward", "grad", grad);
  DerivativeKind const kind = derivative_kind("spatial_gradient_backward", mode, order);
  KV_CHECK(grad.size(2) == order + 1, "spatial_gradient_backward: expected grad of ", order + 1, " channels, got ",
           grad.size(2));
  Tensor const g = dense(grad);
  Tensor const grad_x = empty({g.size(0), g.size(1), g.size(3), g.size(4)}, g);
  dispatch_floating("spatial_gradient_backward", g, [&](auto type) {
    using T = typename decltype(type)::type;
    SpatialGradientBackward<T> const params{stacked_planes<T const>(g), planes<T>(grad_x, Layout::planar), kind,
                                            normalized};
    KV_RUN(spatial_gradient_backward, g, params, params.grad_x.rows(), g.size(4) * (order + 2));
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(spatial_gradient, "(Tensor input, int mode, int order, bool normalized) -> Tensor")
KV_OPERATOR(spatial_gradient_backward, "(Tensor grad, int mode, int order, bool normalized) -> Tensor")

}  // namespace kv::filters
