// Poses of samples: schema and entry, for CPU and CUDA.
#include "geometry/calibration/sample_poses.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// [R | t] (B, S, 3, 4) of samples of four points each; NaN where no pose sees all of them.
Tensor sample_poses(Tensor const& points, Tensor const& pixels, Tensor const& camera, Tensor const& samples) {
  constexpr char const* op = "sample_poses";
  KV_CHECK(points.dim() == 3 && points.size(2) == 3, op, ": expected points of shape (B, N, 3)");
  int64_t const batch = points.size(0), count = points.size(1);
  KV_CHECK(pixels.dim() == 3 && pixels.size(0) == batch && pixels.size(1) == count && pixels.size(2) == 2 &&
               pixels.device() == points.device(),
           op, ": expected pixels of shape (B, N, 2) on the device of points");
  KV_CHECK(camera.dim() == 3 && camera.size(0) == batch && camera.size(1) == 3 && camera.size(2) == 3 &&
               camera.device() == points.device(),
           op, ": expected camera of shape (B, 3, 3) on the device of points");
  KV_CHECK(samples.dim() == 3 && samples.size(0) == batch && samples.size(2) == 4 &&
               samples.scalar_type() == ScalarType::Long && samples.device() == points.device(),
           op, ": expected samples of shape (B, S, 4), int64, on the device of points");
  Contiguous const X(op, points), x(op, pixels), K(op, camera);
  Tensor const indices = dense(samples);
  Tensor const poses = empty({batch, samples.size(1), 3, 4}, X.tensor);
  KV_CHECK(count > 0 || batch * samples.size(1) == 0, op, ": expected points for the samples");
  SamplePoses<double> const params{X.reals, x.reals, K.reals,         data_ptr<int64_t>(indices),
                                   batch,   count,   samples.size(1), reals_of(op, poses)};
  KV_RUN(sample_poses, poses, params, batch * samples.size(1), 4096);
  return poses;
}

}  // namespace

KV_OPERATOR(sample_poses, "(Tensor points, Tensor pixels, Tensor camera, Tensor samples) -> Tensor")

}  // namespace kv::geometry
