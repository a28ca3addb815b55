// Poses with the least reprojection error: schema and entry, for CPU and CUDA.
#include "geometry/optim/fit_poses.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// The poses (B, 7) that poses `start` lead to, their costs, whether a tolerance was reached, and the number of steps.
std::tuple<Tensor, Tensor, Tensor, Tensor> fit_poses(Tensor const& start, Tensor const& points, Tensor const& pixels,
                                                     Tensor const& camera, std::optional<Tensor> const& weights,
                                                     int64_t max_iterations, double ftol, double xtol, double gtol) {
  constexpr char const* op = "fit_poses";
  KV_CHECK(start.dim() == 2 && start.size(1) == 7, op, ": expected start of shape (B, 7)");
  int64_t const batch = start.size(0), count = points.dim() > 1 ? points.size(1) : 0;
  auto const is_like = [&](Tensor const& x, int64_t numbers) {
    return x.dim() == 3 && x.size(0) == batch && x.size(1) == count && x.size(2) == numbers &&
           x.device() == start.device();
  };
  KV_CHECK(is_like(points, 3), op, ": expected points of shape (B, N, 3) on the device of start");
  KV_CHECK(is_like(pixels, 2), op, ": expected pixels of shape (B, N, 2) on the device of start");
  KV_CHECK(camera.dim() == 3 && (camera.size(0) == batch || camera.size(0) == 1) && camera.size(1) == 3 &&
               camera.size(2) == 3 && camera.device() == start.device(),
           op, ": expected camera of shape (B, 3, 3) on the device of start");
  KV_CHECK(!weights || (weights->dim() == 2 && weights->size(0) == batch && weights->size(1) == count &&
                        weights->device() == start.device()),
           op, ": expected weights of shape (B, N) on the device of start");
  KV_CHECK(max_iterations >= 0 && max_iterations < 1 << 30, op, ": expected max_iterations of 0 or more");
  Contiguous const x(op, start), X(op, points), u(op, pixels), K(op, camera), w(op, weights);
  Tensor const poses = empty({batch, 7}, x.tensor), costs = empty({batch}, x.tensor);
  Tensor const converged = empty({batch}, x.tensor, Layout::planar, ScalarType::Bool);
  Tensor const iterations = empty({batch}, x.tensor, Layout::planar, ScalarType::Long);
  double const eps = x.reals.is_double ? 2.220446049250313e-16 : 1.1920928955078125e-07;
  FitPoses<double> const params{x.reals,
                                X.reals,
                                u.reals,
                                K.reals,
                                w.reals,
                                batch,
                                count,
                                camera.size(0) == 1,
                                int(max_iterations),
                                ftol > eps ? ftol : eps,
                                xtol > 4 * eps ? xtol : 4 * eps,
                                gtol,
                                8 * eps,
                                reals_of(op, poses),
                                reals_of(op, costs),
                                data_ptr<bool>(converged),
                                data_ptr<int64_t>(iterations)};
  KV_RUN(fit_poses, poses, params, batch, 64 * count * (1 + max_iterations));
  return {poses, costs, converged, iterations};
}

}  // namespace

KV_OPERATOR(
    fit_poses,
    "(Tensor start, Tensor points, Tensor pixels, Tensor camera, Tensor? weights, int max_iterations, float ftol, "
    "float xtol, float gtol) -> (Tensor, Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
