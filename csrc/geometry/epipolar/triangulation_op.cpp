// Triangulation: schemas and entries, for CPU and CUDA.
#include "geometry/epipolar/triangulation.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// Points of a chunk, over which gradients to projections are summed first.
constexpr int64_t kTriangulationChunk = 1024;

// Pixels and projections, checked.
struct TriangulationArguments {
  Contiguous points1, points2, projections1, projections2;
  Triangulate<double> params{};

  TriangulationArguments(char const* op, Tensor const& x, Tensor const& y, Tensor const& P, Tensor const& Q)
      : points1(op, x), points2(op, y), projections1(op, P), projections2(op, Q) {
    KV_CHECK(x.dim() == 3 && x.size(2) == 2, op, ": expected points1 of shape (B, N, 2)");
    check_like(op, "points2", y, x);
    KV_CHECK(P.dim() == 3 && P.size(0) == x.size(0) && P.size(1) == 3 && P.size(2) == 4 && P.device() == x.device(), op,
             ": expected projections1 of shape (B, 3, 4) on the device of points1");
    check_like(op, "projections2", Q, P);
    params.points1 = points1.reals;
    params.points2 = points2.reals;
    params.projections1 = projections1.reals;
    params.projections2 = projections2.reals;
    params.batch = x.size(0);
    params.count = x.size(1);
    params.min_weight = min_homogeneous_weight(points1);
    params.chunk_size = kTriangulationChunk;
  }
};

Tensor triangulate(Tensor const& points1, Tensor const& points2, Tensor const& projections1,
                   Tensor const& projections2) {
  constexpr char const* op = "triangulate";
  TriangulationArguments arguments(op, points1, points2, projections1, projections2);
  Triangulate<double>& params = arguments.params;
  Tensor const points = empty({params.batch, params.count, 3}, arguments.points1.tensor);
  params.points = reals_of(op, points);
  KV_RUN(triangulate, points, params, params.batch * params.count, 256);
  return points;
}

std::tuple<Tensor, Tensor, Tensor, Tensor> triangulate_backward(Tensor const& grad, Tensor const& points1,
                                                                Tensor const& points2, Tensor const& projections1,
                                                                Tensor const& projections2) {
  constexpr char const* op = "triangulate_backward";
  TriangulationArguments arguments(op, points1, points2, projections1, projections2);
  Triangulate<double>& params = arguments.params;
  int64_t const batch = params.batch, count = params.count, num_chunks = params.num_chunks();
  KV_CHECK(grad.dim() == 3 && grad.size(0) == batch && grad.size(1) == count && grad.size(2) == 3 &&
               grad.device() == points1.device(),
           op, ": expected grad of shape (B, N, 3) on the device of points1");
  Contiguous const g(op, grad);
  Tensor const &x = arguments.points1.tensor, &P = arguments.projections1.tensor;
  Tensor const grad_points1 = empty({batch, count, 2}, x), grad_points2 = empty({batch, count, 2}, x);
  Tensor const grad_projections1 = empty({batch, 3, 4}, P), grad_projections2 = empty({batch, 3, 4}, P);
  Tensor const chunk_sums = empty({batch, num_chunks, 24}, x, Layout::planar, ScalarType::Double);
  params.grad = g.reals;
  params.grad_points1 = reals_of(op, grad_points1);
  params.grad_points2 = reals_of(op, grad_points2);
  params.chunk_sums = reals_of(op, chunk_sums);
  params.grad_projections1 = reals_of(op, grad_projections1);
  params.grad_projections2 = reals_of(op, grad_projections2);
  KV_RUN(triangulate_backward, x, params, batch * num_chunks,
         1024 * (count < kTriangulationChunk ? count : kTriangulationChunk));
  KV_RUN(triangulate_sums, x, params, batch, 24 * num_chunks);
  return {grad_points1, grad_points2, grad_projections1, grad_projections2};
}

}  // namespace

#define KV_TRIANGULATION "Tensor points1, Tensor points2, Tensor projections1, Tensor projections2"

KV_OPERATOR(triangulate, "(" KV_TRIANGULATION ") -> Tensor")
KV_OPERATOR(triangulate_backward, "(Tensor grad, " KV_TRIANGULATION ") -> (Tensor, Tensor, Tensor, Tensor)")

#undef KV_TRIANGULATION

}  // namespace kv::geometry
