// Direct linear transformation: schemas and entries, for CPU and CUDA.
#include "geometry/reals_glue.h"
#include "geometry/solvers/dlt.h"

namespace kv::geometry {
namespace {

// The arguments of a call, checked: points, weights and cameras. The number of problems is that of the weights if all
// problems share the points.
struct DltCall {
  char const* op;
  Contiguous points1, points2, weights, camera;
  Dlt<double> params{};

  DltCall(char const* op, DltModel model, Tensor const& x, Tensor const& y, std::optional<Tensor> const& w,
          std::optional<Tensor> const& k)
      : op(op), points1(op, x), points2(op, y), weights(op, w), camera(op, k) {
    bool const lines = model == DltModel::lines;
    int64_t const axes = model == DltModel::pose ? 3 : 2;
    auto const has_shape = [&](Tensor const& p, int64_t numbers) {
      return p.dim() == (lines ? 4 : 3) && p.size(0) == x.size(0) && p.size(1) == x.size(1) && p.size(2) == numbers &&
             (!lines || p.size(3) == 2) && p.device() == x.device();
    };
    char const* const of_segment = lines ? "2, " : "";
    KV_CHECK(x.dim() > 1 && has_shape(x, axes), op, ": expected points1 of shape (B, N, ", of_segment, axes, ")");
    KV_CHECK(has_shape(y, 2), op, ": expected points2 of shape (B, N, ", of_segment, "2) on the device of points1");
    KV_CHECK(!w || (w->dim() == 2 && (x.size(0) == 1 || w->size(0) == x.size(0)) && w->size(1) == x.size(1) &&
                    w->device() == x.device()),
             op, ": expected weights of shape (B, N) on the device of points1");
    params.model = model;
    params.points1 = points1.reals;
    params.points2 = points2.reals;
    params.weights = weights.reals;
    params.batch = w ? w->size(0) : x.size(0);
    params.count = x.size(1);
    params.stride = x.size(0) == 1 ? 0 : params.count * (lines ? 2 : 1);
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
  Tensor forward() {
    Tensor const models = result({params.batch, 3, columns()}, params.result);
    KV_RUN(dlt, models, params, params.batch, 4096 + 64 * params.count);
    return models;
  }
  // Gradients to both points and to the weights.
  std::tuple<Tensor, Tensor, Tensor> backward(Tensor const& grad) {
    int64_t const batch = params.batch, count = params.count;
    KV_CHECK(points1.tensor.size(0) == batch, op, ": expected points of each problem");
    KV_CHECK(grad.dim() == 3 && grad.size(0) == batch && grad.size(1) == 3 && grad.size(2) == columns() &&
                 grad.device() == points1.tensor.device(),
             op, ": expected grad of shape (B, 3, ", columns(), ") on the device of points1");
    Contiguous const g(op, grad);
    params.grad = g.reals;
    Tensor const grad_points1 = result(points1.tensor.sizes(), params.grad_points1),
                 grad_points2 = result(points2.tensor.sizes(), params.grad_points2),
                 grad_weights = result({batch, count}, params.grad_weights);
    KV_RUN(dlt_backward, grad_points1, params, batch, 16384 + 256 * count);
    return {grad_points1, grad_points2, grad_weights};
  }
};

Tensor homography_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("homography_dlt", DltModel::homography, points1, points2, weights, {}).forward();
}

std::tuple<Tensor, Tensor, Tensor> homography_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                           Tensor const& points2,
                                                           std::optional<Tensor> const& weights) {
  return DltCall("homography_dlt_backward", DltModel::homography, points1, points2, weights, {}).backward(grad);
}

Tensor homography_lines_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("homography_lines_dlt", DltModel::lines, points1, points2, weights, {}).forward();
}

std::tuple<Tensor, Tensor, Tensor> homography_lines_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                                 Tensor const& points2,
                                                                 std::optional<Tensor> const& weights) {
  return DltCall("homography_lines_dlt_backward", DltModel::lines, points1, points2, weights, {}).backward(grad);
}

Tensor fundamental_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("fundamental_dlt", DltModel::fundamental, points1, points2, weights, {}).forward();
}

std::tuple<Tensor, Tensor, Tensor> fundamental_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                            Tensor const& points2,
                                                            std::optional<Tensor> const& weights) {
  return DltCall("fundamental_dlt_backward", DltModel::fundamental, points1, points2, weights, {}).backward(grad);
}

Tensor affine_fit(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  return DltCall("affine_fit", DltModel::affine, points1, points2, weights, {}).forward();
}

std::tuple<Tensor, Tensor, Tensor> affine_fit_backward(Tensor const& grad, Tensor const& points1, Tensor const& points2,
                                                       std::optional<Tensor> const& weights) {
  return DltCall("affine_fit_backward", DltModel::affine, points1, points2, weights, {}).backward(grad);
}

Tensor pose_dlt(Tensor const& points, Tensor const& pixels, Tensor const& camera, std::optional<Tensor> const& weights,
                double min_extent) {
  DltCall call("pose_dlt", DltModel::pose, points, pixels, weights, camera);
  call.params.min_extent = min_extent;
  return call.forward();
}

std::tuple<Tensor, Tensor, Tensor, Tensor> pose_dlt_backward(Tensor const& grad, Tensor const& points,
                                                             Tensor const& pixels, Tensor const& camera,
                                                             std::optional<Tensor> const& weights, double min_extent) {
  DltCall call("pose_dlt_backward", DltModel::pose, points, pixels, weights, camera);
  call.params.min_extent = min_extent;
  Tensor const grad_camera = call.result({call.params.batch, 3, 3}, call.params.grad_camera);
  auto const [grad_points, grad_pixels, grad_weights] = call.backward(grad);
  return {grad_points, grad_pixels, grad_camera, grad_weights};
}

// Points and weights for normalization, checked.
struct NormalizeArguments {
  Contiguous points, weights;
  NormalizedPoints<double> params{};

  NormalizeArguments(char const* op, Tensor const& x, std::optional<Tensor> const& w, double eps)
      : points(op, x), weights(op, w) {
    KV_CHECK(x.dim() == 3 && x.size(2) == 2, op, ": expected points of shape (B, N, 2)");
    KV_CHECK(!w || (w->dim() == 2 && w->size(0) == x.size(0) && w->size(1) == x.size(1) && w->device() == x.device()),
             op, ": expected weights of shape (B, N) on the device of points");
    params.points = points.reals;
    params.weights = weights.reals;
    params.batch = x.size(0);
    params.count = x.size(1);
    params.eps = eps;
  }
};

std::tuple<Tensor, Tensor> normalize_points(Tensor const& points, std::optional<Tensor> const& weights, double eps) {
  constexpr char const* op = "normalize_points";
  NormalizeArguments arguments(op, points, weights, eps);
  NormalizedPoints<double>& params = arguments.params;
  Tensor const normalized = empty({params.batch, params.count, 2}, arguments.points.tensor);
  Tensor const matrix = empty({params.batch, 3, 3}, arguments.points.tensor);
  params.normalized = reals_of(op, normalized);
  params.matrix = reals_of(op, matrix);
  KV_RUN(normalize_points, matrix, params, params.batch, 64 + 32 * params.count);
  return {normalized, matrix};
}

std::tuple<Tensor, Tensor> normalize_points_backward(Tensor const& grad, Tensor const& grad_matrix,
                                                     Tensor const& points, std::optional<Tensor> const& weights,
                                                     double eps) {
  constexpr char const* op = "normalize_points_backward";
  NormalizeArguments arguments(op, points, weights, eps);
  NormalizedPoints<double>& params = arguments.params;
  KV_CHECK(grad.dim() == 3 && grad.size(0) == params.batch && grad.size(1) == params.count && grad.size(2) == 2 &&
               grad.device() == points.device(),
           op, ": expected grad of shape (B, N, 2) on the device of points");
  KV_CHECK(grad_matrix.dim() == 3 && grad_matrix.size(0) == params.batch && grad_matrix.size(1) == 3 &&
               grad_matrix.size(2) == 3 && grad_matrix.device() == points.device(),
           op, ": expected grad_matrix of shape (B, 3, 3) on the device of points");
  Contiguous const g(op, grad), g_matrix(op, grad_matrix);
  Tensor const grad_points = empty({params.batch, params.count, 2}, arguments.points.tensor);
  Tensor const grad_weights = empty({params.batch, params.count}, arguments.points.tensor);
  params.grad = g.reals;
  params.grad_matrix = g_matrix.reals;
  params.grad_points = reals_of(op, grad_points);
  params.grad_weights = reals_of(op, grad_weights);
  KV_RUN(normalize_points_backward, grad_points, params, params.batch, 64 + 128 * params.count);
  return {grad_points, grad_weights};
}

}  // namespace

#define KV_CORRESPONDENCES "Tensor points1, Tensor points2, Tensor? weights"
#define KV_POSE_ARGUMENTS "Tensor points, Tensor pixels, Tensor camera, Tensor? weights, float flat"

KV_OPERATOR(homography_dlt, "(" KV_CORRESPONDENCES ") -> Tensor")
KV_OPERATOR(homography_dlt_backward, "(Tensor grad, " KV_CORRESPONDENCES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(homography_lines_dlt, "(" KV_CORRESPONDENCES ") -> Tensor")
KV_OPERATOR(homography_lines_dlt_backward, "(Tensor grad, " KV_CORRESPONDENCES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(fundamental_dlt, "(" KV_CORRESPONDENCES ") -> Tensor")
KV_OPERATOR(fundamental_dlt_backward, "(Tensor grad, " KV_CORRESPONDENCES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(affine_fit, "(" KV_CORRESPONDENCES ") -> Tensor")
KV_OPERATOR(affine_fit_backward, "(Tensor grad, " KV_CORRESPONDENCES ") -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(pose_dlt, "(" KV_POSE_ARGUMENTS ") -> Tensor")
KV_OPERATOR(pose_dlt_backward, "(Tensor grad, " KV_POSE_ARGUMENTS ") -> (Tensor, Tensor, Tensor, Tensor)")
KV_OPERATOR(normalize_points, "(Tensor points, Tensor? weights, float eps) -> (Tensor, Tensor)")
KV_OPERATOR(normalize_points_backward,
            "(Tensor grad, Tensor grad_matrix, Tensor points, Tensor? weights, float eps) -> (Tensor, Tensor)")

#undef KV_CORRESPONDENCES
#undef KV_POSE_ARGUMENTS

}  // namespace kv::geometry
