// Robust poses: schema and entry, for CPU and CUDA.
#include "geometry/calibration/robust_poses.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// Poses (B, 7) of the best of hypotheses, fitted; the weights (B, N) of the next fit, and the inliers.
std::tuple<Tensor, Tensor, Tensor> robust_poses(Tensor const& hypotheses, Tensor const& points, Tensor const& pixels,
                                                Tensor const& camera, std::optional<Tensor> const& mask,
                                                double threshold, double reach, int64_t rounds, int64_t steps,
                                                double tolerance) {
  constexpr char const* op = "robust_poses";
  KV_CHECK(hypotheses.dim() == 4 && hypotheses.size(1) > 0 && hypotheses.size(2) == 3 && hypotheses.size(3) == 4, op,
           ": expected hypotheses of shape (B, S, 3, 4), one or more");
  int64_t const batch = hypotheses.size(0), count = points.dim() > 1 ? points.size(1) : 0;
  auto const is_like = [&](Tensor const& x, int64_t rows, int64_t numbers) {
    return x.dim() == 3 && x.size(0) == batch && x.size(1) == rows && x.size(2) == numbers &&
           x.device() == hypotheses.device();
  };
  KV_CHECK(is_like(points, count, 3), op, ": expected points of shape (B, N, 3) on the device of hypotheses");
  KV_CHECK(is_like(pixels, count, 2), op, ": expected pixels of shape (B, N, 2) on the device of hypotheses");
  KV_CHECK(is_like(camera, 3, 3), op, ": expected camera of shape (B, 3, 3) on the device of hypotheses");
  KV_CHECK(!mask || (mask->dim() == 2 && mask->size(0) == batch && mask->size(1) == count &&
                     mask->scalar_type() == ScalarType::Bool && mask->device() == hypotheses.device()),
           op, ": expected mask of shape (B, N), bool, on the device of hypotheses");
  KV_CHECK(threshold > 0 && reach > 0, op, ": expected threshold and reach above 0");
  KV_CHECK(rounds >= 0 && rounds < 1 << 30 && steps >= 0 && steps < 1 << 30, op,
           ": expected rounds and steps of 0 or more");
  Contiguous const P(op, hypotheses), X(op, points), u(op, pixels), K(op, camera);
  Tensor const existing = mask ? dense(*mask) : P.tensor;
  Tensor const poses = empty({batch, 7}, P.tensor), weights = empty({batch, count}, P.tensor);
  Tensor const inliers = empty({batch, count}, P.tensor, Layout::planar, ScalarType::Bool);
  double const eps = P.reals.is_double ? 2.220446049250313e-16 : 1.1920928955078125e-07;
  FitPoses<double> fit{};
  fit.points = X.reals, fit.pixels = u.reals, fit.camera = K.reals, fit.weights = reals_of(op, weights);
  fit.batch = batch, fit.count = count;
  fit.max_iterations = int(steps);
  fit.ftol = tolerance > eps ? tolerance : eps, fit.xtol = tolerance > 4 * eps ? tolerance : 4 * eps;
  fit.gtol = tolerance, fit.slack = 8 * eps;
  fit.poses = reals_of(op, poses);
  RobustPoses<double> const params{P.reals,     mask ? data_ptr<bool const>(existing) : nullptr,
                                   fit,         hypotheses.size(1),
                                   int(rounds), threshold,
                                   reach,       data_ptr<bool>(inliers)};
  KV_RUN(robust_poses, poses, params, batch, count * (8 * params.num_hypotheses + 64 * rounds * steps));
  return {poses, weights, inliers};
}

}  // namespace

KV_OPERATOR(
    robust_poses,
    "(Tensor hypotheses, Tensor points, Tensor pixels, Tensor camera, Tensor? mask, float threshold, float reach, "
    "int rounds, int steps, float tolerance) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
