// Essential matrices: schemas and entries, for CPU and CUDA.
#include "geometry/epipolar/essential.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

void check_matrices(char const* op, char const* name, Tensor const& x, Tensor const& like) {
  KV_CHECK(x.dim() == 3 && x.size(0) == like.size(0) && x.size(1) == 3 && x.size(2) == 3 && x.device() == like.device(),
           op, ": expected ", name, " of shape (B, 3, 3) on one device");
}

Essential<double> essential_params(Contiguous const& matrices, bool nearest) {
  Essential<double> params{};
  params.matrix = matrices.reals;
  params.batch = matrices.tensor.size(0);
  params.nearest = nearest;
  return params;
}

Tensor nearest_essential(Tensor const& matrix) {
  constexpr char const* op = "nearest_essential";
  check_matrices(op, "matrix", matrix, matrix);
  Contiguous const e(op, matrix);
  Tensor const projected = empty({matrix.size(0), 3, 3}, e.tensor);
  Essential<double> params = essential_params(e, true);
  params.projected = reals_of(op, projected);
  KV_RUN(essential, e.tensor, params, params.batch, 512);
  return projected;
}

Tensor nearest_essential_backward(Tensor const& grad, Tensor const& matrix) {
  constexpr char const* op = "nearest_essential_backward";
  check_matrices(op, "matrix", matrix, matrix);
  check_matrices(op, "grad", grad, matrix);
  Contiguous const g(op, grad), e(op, matrix);
  Tensor const grad_matrix = empty({matrix.size(0), 3, 3}, e.tensor);
  Essential<double> params = essential_params(e, true);
  params.grad = g.reals;
  params.grad_matrix = reals_of(op, grad_matrix);
  KV_RUN(essential_backward, e.tensor, params, params.batch, 512);
  return grad_matrix;
}

std::tuple<Tensor, Tensor> essential_motions(Tensor const& matrix) {
  constexpr char const* op = "essential_motions";
  check_matrices(op, "matrix", matrix, matrix);
  Contiguous const e(op, matrix);
  int64_t const batch = matrix.size(0);
  Tensor const rotations = empty({batch, 4, 3, 3}, e.tensor), directions = empty({batch, 4, 3, 1}, e.tensor);
  Essential<double> params = essential_params(e, false);
  params.rotations = reals_of(op, rotations);
  params.directions = reals_of(op, directions);
  KV_RUN(essential, e.tensor, params, batch, 512);
  return {rotations, directions};
}

Tensor essential_motions_backward(Tensor const& grad, Tensor const& grad_directions, Tensor const& matrix) {
  constexpr char const* op = "essential_motions_backward";
  check_matrices(op, "matrix", matrix, matrix);
  int64_t const batch = matrix.size(0);
  KV_CHECK(grad.dim() == 4 && grad.size(0) == batch && grad.numel() == 36 * batch && grad_directions.dim() == 4 &&
               grad_directions.size(0) == batch && grad_directions.numel() == 12 * batch &&
               grad.device() == matrix.device() && grad_directions.device() == matrix.device(),
           op, ": expected gradients of shapes (B, 4, 3, 3) and (B, 4, 3, 1) on one device");
  Contiguous const g(op, grad), t(op, grad_directions), e(op, matrix);
  Tensor const grad_matrix = empty({batch, 3, 3}, e.tensor);
  Essential<double> params = essential_params(e, false);
  params.grad = g.reals;
  params.grad_directions = t.reals;
  params.grad_matrix = reals_of(op, grad_matrix);
  KV_RUN(essential_backward, e.tensor, params, batch, 512);
  return grad_matrix;
}

std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor> motion_choice(Tensor const& matrix, Tensor const& camera1,
                                                                 Tensor const& camera2, Tensor const& points1,
                                                                 Tensor const& points2,
                                                                 std::optional<Tensor> const& mask) {
  constexpr char const* op = "motion_choice";
  check_matrices(op, "matrix", matrix, matrix);
  check_matrices(op, "camera1", camera1, matrix);
  check_matrices(op, "camera2", camera2, matrix);
  int64_t const batch = matrix.size(0);
  KV_CHECK(
      points1.dim() == 3 && points1.size(0) == batch && points1.size(2) == 2 && points1.device() == matrix.device(), op,
      ": expected points1 of shape (B, N, 2) on the device of matrix");
  check_like(op, "points2", points2, points1);
  int64_t const count = points1.size(1);
  KV_CHECK(!mask || (mask->scalar_type() == ScalarType::Bool && mask->dim() == 2 && mask->size(0) == batch &&
                     mask->size(1) == count && mask->device() == matrix.device()),
           op, ": expected mask to be bool of shape (B, N) on the device of matrix");
  Contiguous const e(op, matrix), k1(op, camera1), k2(op, camera2), x(op, points1), y(op, points2);
  std::optional<Tensor> const dense_mask = mask ? std::optional(dense(*mask)) : std::nullopt;
  Tensor const rotation = empty({batch, 3, 3}, e.tensor), direction = empty({batch, 3, 1}, e.tensor);
  Tensor const points = empty({batch, count, 3}, e.tensor);
  Tensor const in_front = empty({batch}, e.tensor, Layout::planar, ScalarType::Long);
  Tensor const motion_index = empty({batch}, e.tensor, Layout::planar, ScalarType::Long);
  MotionChoice<double> const params{e.reals,
                                    k1.reals,
                                    k2.reals,
                                    x.reals,
                                    y.reals,
                                    dense_mask ? data_ptr<bool const>(*dense_mask) : nullptr,
                                    batch,
                                    count,
                                    min_homogeneous_weight(x),
                                    reals_of(op, rotation),
                                    reals_of(op, direction),
                                    reals_of(op, points),
                                    data_ptr<int64_t>(in_front),
                                    data_ptr<int64_t>(motion_index)};
  KV_RUN(motion_choice, e.tensor, params, batch, 512 + 1024 * count);
  return {rotation, direction, points, in_front, motion_index};
}

}  // namespace

KV_OPERATOR(nearest_essential, "(Tensor matrix) -> Tensor")
KV_OPERATOR(nearest_essential_backward, "(Tensor grad, Tensor matrix) -> Tensor")
KV_OPERATOR(essential_motions, "(Tensor matrix) -> (Tensor, Tensor)")
KV_OPERATOR(essential_motions_backward, "(Tensor grad, Tensor grad_directions, Tensor matrix) -> Tensor")
KV_OPERATOR(motion_choice,
            "(Tensor matrix, Tensor camera1, Tensor camera2, Tensor points1, Tensor points2, Tensor? mask) -> "
            "(Tensor, Tensor, Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
