// Affine shapes: schemas and entries, for CPU and CUDA.
#include "affine_shape.h"
#include "patch_glue.h"

namespace kv::feature {
namespace {

// One over the squared sum of the Gaussian of a patch and over its area.
double moment_scale(int n) {
  double sum = 0;
  for (int i = 0; i < n; ++i) sum += centered_gaussian(i, n, n * 0.70710678118654752440);
  return 1 / (sum * sum * sum * sum * n * n);
}

Tensor affine_shape(Tensor const& patches, double eps) {
  int const n = check_patches("affine_shape", patches);
  Tensor const x = dense(patches), shapes = empty({x.size(0), 3}, x);
  dispatch_floating("affine_shape", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    AffineShape<T> const params{data_ptr<T const>(x), data_ptr<T>(shapes), x.size(0), n, F(eps), F(moment_scale(n))};
    KV_RUN(affine_shape, x, params, params.count, 8 * n * n);
  });
  return shapes;
}

Tensor affine_shape_backward(Tensor const& grad, Tensor const& patches, double eps) {
  constexpr char const* op = "affine_shape_backward";
  int const n = check_patches(op, patches);
  check_patch_gradient(op, grad, patches, {patches.size(0), 3});
  Tensor const g = dense(grad), x = dense(patches), grad_x = empty(x.sizes(), x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    AffineShapeBackward<T> const params{
        data_ptr<T const>(g), data_ptr<T const>(x), data_ptr<T>(grad_x), x.size(0), n, F(eps), F(moment_scale(n))};
    KV_RUN(affine_shape_backward, x, params, params.count, 16 * n * n);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(affine_shape, "(Tensor patches, float eps) -> Tensor")
KV_OPERATOR(affine_shape_backward, "(Tensor grad, Tensor patches, float eps) -> Tensor")

}  // namespace kv::feature
