// Bundles: schema and entry, for CPU and CUDA.
#include "geometry/optim/fit_bundle.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// Memory for doubles that several tensors would take.
struct Workspace {
  Tensor tensor;
  double* next;
  Workspace(int64_t count, Tensor const& like)
      : tensor(empty({count}, like, Layout::planar, ScalarType::Double)), next(data_ptr<double>(tensor)) {}
  double* take(int64_t count) {
    double* const first = next;
    next += count;
    return first;
  }
};

#if !defined(KV_CUDA)
bool are_idle(FitBundle<double> const& p) {
  for (int64_t b = 0; b < p.batch; ++b)
    if (!p.is_idle(b)) return false;
  return true;
}
#endif

// The poses (B, C, 7) and points (B, K, 3) that a start leads to, their costs, whether a tolerance was reached, and the
// number of steps.
std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor> fit_bundle(
    Tensor const& poses, Tensor const& points, Tensor const& pixels, Tensor const& camera, Tensor const& camera_index,
    Tensor const& point_index, Tensor const& by_camera, Tensor const& camera_offsets, Tensor const& point_offsets,
    std::optional<Tensor> const& weights, int64_t loss, double scale, int64_t max_iterations, double ftol, double xtol,
    double gtol) {
  constexpr char const* op = "fit_bundle";
  KV_CHECK(poses.dim() == 3 && poses.size(2) == 7, op, ": expected poses of shape (B, C, 7)");
  int64_t const batch = poses.size(0), num_cameras = poses.size(1);
  KV_CHECK(num_cameras <= kMaxBundleCameras, op, ": expected at most ", kMaxBundleCameras, " poses");
  auto const is_like = [&](Tensor const& x, int64_t rows, int64_t numbers) {
    return x.dim() == 3 && x.size(0) == batch && (rows < 0 || x.size(1) == rows) && x.size(2) == numbers &&
           x.device() == poses.device();
  };
  KV_CHECK(is_like(points, -1, 3), op, ": expected points of shape (B, K, 3) on the device of poses");
  KV_CHECK(is_like(pixels, -1, 2), op, ": expected pixels of shape (B, N, 2) on the device of poses");
  int64_t const num_points = points.size(1), count = pixels.size(1);
  KV_CHECK(camera.dim() == 3 && (camera.size(0) == batch || camera.size(0) == 1) && camera.size(1) == 3 &&
               camera.size(2) == 3 && camera.device() == poses.device(),
           op, ": expected camera of shape (B, 3, 3) on the device of poses");
  KV_CHECK(!weights || (weights->dim() == 2 && weights->size(0) == batch && weights->size(1) == count &&
                        weights->device() == poses.device()),
           op, ": expected weights of shape (B, N) on the device of poses");
  auto const numbers = [&](char const* name, Tensor const& x, int64_t size) {
    KV_CHECK(x.dim() == 2 && x.size(0) == 1 && x.size(1) == size && x.scalar_type() == ScalarType::Int &&
                 x.device() == poses.device(),
             op, ": expected ", name, " of shape (1, ", size, "), int32, on the device of poses");
    return dense(x);
  };
  Tensor const cameras = numbers("camera_index", camera_index, count),
               sees = numbers("point_index", point_index, count);
  Tensor const order = numbers("by_camera", by_camera, count);
  Tensor const of_camera = numbers("camera_offsets", camera_offsets, num_cameras + 1);
  Tensor const of_point = numbers("point_offsets", point_offsets, num_points + 1);
  KV_CHECK(num_cameras > 0 && num_points > 0, op, ": expected poses and points");
  KV_CHECK(loss >= 0 && loss <= int64_t(RobustLoss::tukey), op, ": expected loss from 0 to ", int(RobustLoss::tukey));
  KV_CHECK(scale > 0, op, ": expected scale above 0");
  KV_CHECK(max_iterations >= 0 && max_iterations < 1 << 30, op, ": expected max_iterations of 0 or more");
  Contiguous const x(op, poses), X(op, points), u(op, pixels), K(op, camera), w(op, weights);
  Tensor const poses_out = empty({batch, num_cameras, 7}, x.tensor),
               points_out = empty({batch, num_points, 3}, x.tensor);
  Tensor const costs = empty({batch}, x.tensor);
  Tensor const converged = empty({batch}, x.tensor, Layout::planar, ScalarType::Bool);
  Tensor const iterations = empty({batch}, x.tensor, Layout::planar, ScalarType::Long);
  Tensor const couplings = empty({batch, count, 6, 3}, x.tensor);
  int64_t const pitch = bundles::kTile * ceil_div(6 * num_cameras + 1, int64_t(bundles::kTile));
  constexpr int64_t kState = sizeof(BundleState) / sizeof(double);
  Workspace workspace(batch * (kState + num_cameras * 36 + num_points * 23 + pitch * (pitch + bundles::kTile)),
                      x.tensor);
  double const eps = x.reals.is_double ? 2.220446049250313e-16 : 1.1920928955078125e-07;
  FitBundle<double> p{};
  p.start_poses = x.reals, p.start_points = X.reals;
  p.pixels = u.reals, p.camera = K.reals, p.weights = w.reals;
  p.cameras = data_ptr<int32_t>(cameras), p.points = data_ptr<int32_t>(sees), p.by_camera = data_ptr<int32_t>(order);
  p.of_camera = data_ptr<int32_t>(of_camera), p.of_point = data_ptr<int32_t>(of_point);
  p.batch = batch, p.count = count, p.num_cameras = num_cameras, p.num_points = num_points;
  p.one_camera = camera.size(0) == 1;
  p.loss = RobustLoss(loss), p.squared_scale = scale * scale;
  p.ftol = ftol > eps ? ftol : eps, p.xtol = xtol > 4 * eps ? xtol : 4 * eps, p.gtol = gtol, p.slack = 8 * eps;
  p.state = reinterpret_cast<BundleState*>(workspace.take(batch * kState));
  p.poses = workspace.take(batch * num_cameras * 14), p.positions = workspace.take(batch * num_points * 6);
  p.camera_terms = workspace.take(batch * num_cameras * 18), p.point_terms = workspace.take(batch * num_points * 12);
  p.camera_sums = workspace.take(batch * num_cameras * 4), p.point_sums = workspace.take(batch * num_points * 5);
  p.matrix = workspace.take(batch * pitch * pitch), p.diagonal = workspace.take(batch * pitch * bundles::kTile);
  p.couplings = reals_of(op, couplings), p.pitch = pitch;
  p.poses_out = reals_of(op, poses_out), p.points_out = reals_of(op, points_out), p.costs = reals_of(op, costs);
  p.converged = data_ptr<bool>(converged), p.iterations = data_ptr<int64_t>(iterations);

  int64_t const all_cameras = batch * num_cameras, all_points = batch * num_points;
  int64_t const of_each = 64 * (1 + count / (num_points + 1)), unknowns = 6 * num_cameras;
  p.is_first = true;
  KV_RUN(bundle_start, x.tensor, p, all_cameras + all_points, 8);
  KV_RUN(bundle_evaluate, x.tensor, p, all_points, of_each);
  KV_RUN(bundle_accept, x.tensor, p, batch, num_points);
  p.is_first = false;
  for (int64_t step = 0; step < max_iterations; ++step) {
#if !defined(KV_CUDA)
    if (are_idle(p)) break;
#endif
    KV_RUN(bundle_points, x.tensor, p, all_points, 2 * of_each);
    KV_RUN(bundle_cameras, x.tensor, p, all_cameras, 1 + count * of_each / (num_cameras + 1));
    KV_RUN(bundle_factor, x.tensor, p, batch, unknowns * unknowns);
    KV_RUN(bundle_solve, x.tensor, p, batch, unknowns * unknowns);
    KV_RUN(bundle_evaluate, x.tensor, p, all_points, of_each);
    KV_RUN(bundle_accept, x.tensor, p, batch, num_points);
  }
  KV_RUN(bundle_finish, x.tensor, p, all_cameras + all_points, 8);
  return {poses_out, points_out, costs, converged, iterations};
}

}  // namespace

KV_OPERATOR(fit_bundle,
            "(Tensor poses, Tensor points, Tensor pixels, Tensor camera, Tensor camera_index, Tensor point_index, "
            "Tensor by_camera, Tensor camera_offsets, Tensor point_offsets, Tensor? weights, int loss, float scale, "
            "int max_iterations, float ftol, float xtol, float gtol) -> (Tensor, Tensor, Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
