// Projections between cameras: schemas and entries, for CPU and CUDA.
#include "geometry/depth/reprojection.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// The four matrices, checked; a single one of each serves the batch.
struct ReprojectionArguments {
  ReprojectionParams<double> params{};

  ReprojectionArguments(char const* op, Tensor const& camera_to, Tensor const& pose_to, Tensor const& camera_from,
                        std::optional<Tensor> const& pose_from, bool pinhole) {
    params.batch = 1;
    params.pinhole = pinhole;
    auto const add_matrix = [&](char const* name, Tensor const& x, int64_t side) {
      KV_CHECK(x.dim() == 3 && x.size(1) == side && x.size(2) == side && x.scalar_type() == camera_to.scalar_type() &&
                   x.device() == camera_to.device(),
               op, ": expected ", name, " of shape (B, ", side, ", ", side, "), all of one type and device");
      KV_CHECK(params.batch == 1 || x.size(0) == 1 || x.size(0) == params.batch, op, ": expected ", name, " with 1 or ",
               params.batch, " rows, got ", x.size(0));
      if (x.size(0) != 1) params.batch = x.size(0);
      Tensor const rows = x.stride(2) == 1 ? x : dense(x);  // for example a block of larger matrices
      contiguous[count++] = rows;
      return Matrices{reals_of(op, rows), x.size(0) == 1 ? 0 : rows.stride(0), rows.stride(1)};
    };
    params.camera_to = add_matrix("camera_to", camera_to, 3);
    params.pose_to = add_matrix("pose_to", pose_to, 4);
    params.camera_from = add_matrix("camera_from", camera_from, 3);
    if (pose_from) params.pose_from = add_matrix("pose_from", *pose_from, 4);
  }

 private:
  std::optional<Tensor> contiguous[4];
  int count = 0;
};

Tensor reprojection(Tensor const& camera_to, Tensor const& pose_to, Tensor const& camera_from,
                    std::optional<Tensor> const& pose_from, bool pinhole) {
  constexpr char const* op = "reprojection";
  ReprojectionArguments arguments(op, camera_to, pose_to, camera_from, pose_from, pinhole);
  int64_t const batch = arguments.params.batch;
  Tensor const projection = empty({batch, 3, 4}, camera_to);
  arguments.params.projection = reals_of(op, projection);
  KV_RUN(reprojection, projection, arguments.params, batch, 256);
  return projection;
}

// Gradients for each sample, also for matrices that all samples share.
std::tuple<Tensor, Tensor, Tensor, Tensor> reprojection_backward(Tensor const& grad, Tensor const& camera_to,
                                                                 Tensor const& pose_to, Tensor const& camera_from,
                                                                 std::optional<Tensor> const& pose_from, bool pinhole) {
  constexpr char const* op = "reprojection_backward";
  ReprojectionArguments arguments(op, camera_to, pose_to, camera_from, pose_from, pinhole);
  int64_t const batch = arguments.params.batch;
  KV_CHECK(grad.dim() == 3 && grad.size(0) == batch && grad.size(1) == 3 && grad.size(2) == 4 &&
               grad.scalar_type() == camera_to.scalar_type() && grad.device() == camera_to.device(),
           op, ": expected grad of shape (B, 3, 4), all of one type and device");
  Contiguous const g(op, grad);
  auto const result = [&](int64_t side) { return empty({batch, side, side}, g.tensor); };
  Tensor const grad_camera_to = result(3), grad_pose_to = result(4), grad_camera_from = result(3),
               grad_pose_from = result(4);
  arguments.params.grad = g.reals;
  arguments.params.grad_camera_to = reals_of(op, grad_camera_to);
  arguments.params.grad_pose_to = reals_of(op, grad_pose_to);
  arguments.params.grad_camera_from = reals_of(op, grad_camera_from);
  arguments.params.grad_pose_from = reals_of(op, grad_pose_from);
  KV_RUN(reprojection_backward, g.tensor, arguments.params, batch, 512);
  return {grad_camera_to, grad_pose_to, grad_camera_from, grad_pose_from};
}

}  // namespace

#define KV_CAMERAS "Tensor camera_to, Tensor pose_to, Tensor camera_from, Tensor? pose_from, bool pinhole"

KV_OPERATOR(reprojection, "(" KV_CAMERAS ") -> Tensor")
KV_OPERATOR(reprojection_backward, "(Tensor grad, " KV_CAMERAS ") -> (Tensor, Tensor, Tensor, Tensor)")

#undef KV_CAMERAS

}  // namespace kv::geometry
