// Direct linear transformation: schemas and entries, for CPU and CUDA alike.
#include "dlt.h"
#include "views_glue.h"

namespace kv {
namespace {

// What one call has: points, weights and cameras, checked. The number of problems is that of weights, where one has the
// points of all.
struct DltCall {
  char const* op;
  Contiguous points1, points2, weights, camera;
  Dlt<double> params{};

  DltCall(char const* op, DltModel model, Tensor const& x, Tensor const& y, std::optional<Tensor> const& w,
          std::optional<Tensor> const& k)
      : op(op), points1(op, x), points2(op, y), weights(op, w), camera(op, k) {
    int64_t const axes = model == DltModel::pose ? 3 : 2;
    KV_CHECK(x.dim() == 3 && x.size(2) == axes, op, ": expected points1 of shape (B, N, ", axes, ")");
    KV_CHECK(
        y.dim() == 3 && y.size(0) == x.size(0) && y.size(1) == x.size(1) && y.size(2) == 2 && y.device() == x.device(),
        op, ": expected points2 of shape (B, N, 2) on the device of points1");
    KV_CHECK(!w || (w->dim() == 2 && (x.size(0) == 1 || w->size(0) == x.size(0)) && w->size(1) == x.size(1) &&
                    w->device() == x.device()),
             op, ": expected weights of shape (B, N) on the device of points1");
    params.model = model;
    params.points1 = points1.reals;
    params.points2 = points2.reals;
    params.weights = weights.reals;
    params.batch = w ? w->size(0) : x.size(0);
    params.count = x.size(1);
    params.stride = x.size(0) == 1 ? 0 : params.count;
    if (!k) return;
    KV_CHECK(
        k->dim() == 3 && k->size(0) == params.batch && k->size(1) == 3 && k->size(2) == 3 && k->device() == x.device(),
        op, ": expected intrinsics of shape (B, 3, 3) on the device of points1");
    params.camera = camera.reals;
  }
  Tensor result(torch::headeronly::IntHeaderOnlyArrayRef sizes, Reals& written) const {
    Tensor const x = empty(sizes, points1.tensor);
    written = reals_of(op, x);
    return x;
  }
  int64_t columns() const { return params.model == DltModel::pose ? 4 : 3; }
  Tensor find() {
    Tensor const found = result({params.batch, 3, columns()}, params.found);
    KV_RUN(dlt, found, params, params.batch, 4096 + 64 * params.count);
    return found;
  }
  // To both points and to the weights.
  std::tuple<Tensor, Tensor, Tensor> differentiate(Tensor const& grad) {
    int64_t const batch = params.batch, count = params.count, axes = columns() - 1;
    KV_CHECK(points1.tensor.size(0) == batch, op, ": expected points of each problem");
    KV_CHECK(grad.dim() == 3 && grad.size(0) == batch && grad.size(1) == 3 && grad.size(2) == columns() &&
                 grad.device() == points1.tensor.device(),
             op, ": expected grad of shape (B, 3, ", columns(), ") on the device of points1");
    Contiguous const g(op, grad);
    params.grad = g.reals;
    Tensor const grad1 = result({batch, count, axes}, params.grad1), grad2 = result({batch, count, 2}, params.grad2),
                 grad_weights = result({batch, count}, params.grad_weights);
    KV_RUN(dlt_backward, grad1, params, batch, 16384 + 256 * count);
    return {grad1, grad2, grad_weights};
  }
};

Tensor homography_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("homography_dlt", DltModel::homography, points1, points2, weights, {}).find();
}

std::tuple<Tensor, Tensor, Tensor> homography_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                           Tensor const& points2,
                                                           std::optional<Tensor> const& weights) {
  return DltCall("homography_dlt_backward", DltModel::homography, points1, points2, weights, {}).differentiate(grad);
}

Tensor fundamental_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("fundamental_dlt", DltModel::fundamental, points1, points2, weights, {}).find();
}

std::tuple<Tensor, Tensor, Tensor> fundamental_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                            Tensor const& points2,
                                                            std::optional<Tensor> const& weights) {
  return DltCall("fundamental_dlt_backward", DltModel::fundamental, points1, points2, weights, {}).differentiate(grad);
}

Tensor affine_fit(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("affine_fit", DltModel::affine, points1, points2, weights, {}).find();
}

std::tuple<Tensor, Tensor, Tensor> affine_fit_backward(Tensor const& grad, Tensor const& points1, Tensor const& points2,
                                                       std::optional<Tensor> const& weights) {
  return DltCall("affine_fit_backward", DltModel::affine, points1, points2, weights, {}).differentiate(grad);
}

Tensor pose_dlt(Tensor const& points, Tensor const& pixels, Tensor const& camera, std::optional<Tensor> const& weights,
                double flat) {
  DltCall call("pose_dlt", DltModel::pose, points, pixels, weights, camera);
  call.params.flat = flat;
  return call.find();
}

std::tuple<Tensor, Tensor, Tensor, Tensor> pose_dlt_backward(Tensor const& grad, Tensor const& points,
                                                             Tensor const& pixels, Tensor const& camera,
                                                             std::optional<Tensor> const& weights, double flat) {
  DltCall call("pose_dlt_backward", DltModel::pose, points, pixels, weights, camera);
  call.params.flat = flat;
  Tensor const grad_camera = call.result({call.params.batch, 3, 3}, call.params.grad_camera);
  auto const [grad_points, grad_pixels, grad_weights] = call.differentiate(grad);
  return {grad_points, grad_pixels, grad_camera, grad_weights};
}

}  // namespace

#define KV_MATCHES "Tensor points1, Tensor points2, Tensor? weights"
#define KV_PICTURES "Tensor points, Tensor pixels, Tensor camera, Tensor? weights, float flat"

KV_OPERATOR(homography_dlt, "(" KV_MATCHES ") -> Tensor")
KV_OPERATOR(homography_dlt_backward, "(Tensor grad, " KV_MATCHES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(fundamental_dlt, "(" KV_MATCHES ") -> Tensor")
KV_OPERATOR(fundamental_dlt_backward, "(Tensor grad, " KV_MATCHES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(affine_fit, "(" KV_MATCHES ") -> Tensor")
KV_OPERATOR(affine_fit_backward, "(Tensor grad, " KV_MATCHES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(pose_dlt, "(" KV_PICTURES ") -> Tensor")
KV_OPERATOR(pose_dlt_backward, "(Tensor grad, " KV_PICTURES ") -> (Tensor, Tensor, Tensor, Tensor)")

#undef KV_MATCHES
#undef KV_PICTURES

}  // namespace kv
