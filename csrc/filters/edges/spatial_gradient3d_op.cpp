// Derivatives of a volume: schemas and entries, for CPU and CUDA. Volumes are read contiguous.
#include "glue/glue.h"
#include "spatial_gradient3d.h"

namespace kv::filters {
namespace {

void check_order(char const* op, int64_t order) {
  KV_CHECK(order == 1 || order == 2, op, ": order must be 1 or 2; got ", order);
}

Tensor spatial_gradient3d(Tensor const& input, int64_t order) {
  check_volumes("spatial_gradient3d", "input", input);
  check_order("spatial_gradient3d", order);
  Tensor const x = dense(input);
  int64_t const depth = x.size(2), width = x.size(4);
  Tensor const y = empty({x.size(0), x.size(1), 3 * order, depth, x.size(3), width}, x);
  dispatch_floating("spatial_gradient3d", x, [&](auto type) {
    using T = typename decltype(type)::type;
    SpatialGradient3d<T> const params{stacked_planes<T const>(x), stacked_planes<T>(y), depth, int(order)};
    KV_RUN(spatial_gradient3d, x, params, params.x.rows(), width * (1 + 3 * order));
  });
  return y;
}

Tensor spatial_gradient3d_backward(Tensor const& grad, int64_t order) {
  check_order("spatial_gradient3d_backward", order);
  KV_CHECK(grad.dim() == 6 && grad.size(2) == 3 * order, "spatial_gradient3d_backward: expected grad of shape (B, C, ",
           3 * order, ", D, H, W)");
  KV_CHECK(grad.size(3) > 0 && grad.size(4) > 0 && grad.size(5) > 0, "spatial_gradient3d_backward: grad has no voxels");
  Tensor const g = dense(grad);
  int64_t const depth = g.size(3), width = g.size(5);
  Tensor const grad_x = empty({g.size(0), g.size(1), depth, g.size(4), width}, g);
  dispatch_floating("spatial_gradient3d_backward", g, [&](auto type) {
    using T = typename decltype(type)::type;
    SpatialGradient3dBackward<T> const params{stacked_planes<T const>(g), stacked_planes<T>(grad_x), depth, int(order)};
    KV_RUN(spatial_gradient3d_backward, g, params, params.grad_x.rows(), width * (1 + 3 * order));
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(spatial_gradient3d, "(Tensor input, int order) -> Tensor")
KV_OPERATOR(spatial_gradient3d_backward, "(Tensor grad, int order) -> Tensor")

}  // namespace kv::filters
