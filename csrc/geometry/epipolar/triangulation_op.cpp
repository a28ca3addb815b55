// Triangulation: schema and entry, for CPU and CUDA alike.
#include "geometry/epipolar/triangulation.h"
#include "geometry/reals_glue.h"

namespace kv {
namespace {

// Points of a part, whose gradients to the projections are summed up first.
constexpr int64_t kSeenPart = 1024;

// Pictures and projections, checked.
struct GivenPictures {
  Contiguous points1, points2, projections1, projections2;
  Triangulate<double> params{};

  GivenPictures(char const* op, Tensor const& x, Tensor const& y, Tensor const& P, Tensor const& Q)
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
    params.least = least_share(points1);
    params.part = kSeenPart;
  }
};

Tensor triangulate(Tensor const& points1, Tensor const& points2, Tensor const& projections1,
                   Tensor const& projections2) {
  constexpr char const* op = "triangulate";
  GivenPictures given(op, points1, points2, projections1, projections2);
  Triangulate<double>& params = given.params;
  Tensor const points = empty({params.batch, params.count, 3}, given.points1.tensor);
  params.points = reals_of(op, points);
  KV_RUN(triangulate, points, params, params.batch * params.count, 256);
  return points;
}

std::tuple<Tensor, Tensor, Tensor, Tensor> triangulate_backward(Tensor const& grad, Tensor const& points1,
                                                                Tensor const& points2, Tensor const& projections1,
                                                                Tensor const& projections2) {
  constexpr char const* op = "triangulate_backward";
  GivenPictures given(op, points1, points2, projections1, projections2);
  Triangulate<double>& params = given.params;
  int64_t const batch = params.batch, count = params.count, parts = params.part_count();
  KV_CHECK(grad.dim() == 3 && grad.size(0) == batch && grad.size(1) == count && grad.size(2) == 3 &&
               grad.device() == points1.device(),
           op, ": expected grad of shape (B, N, 3) on the device of points1");
  Contiguous const g(op, grad);
  Tensor const &x = given.points1.tensor, &P = given.projections1.tensor;
  Tensor const to1 = empty({batch, count, 2}, x), to2 = empty({batch, count, 2}, x);
  Tensor const to_P = empty({batch, 3, 4}, P), to_Q = empty({batch, 3, 4}, P);
  Tensor const sums = empty({batch, parts, 24}, x, Layout::planar, ScalarType::Double);
  params.grad = g.reals;
  params.to1 = reals_of(op, to1);
  params.to2 = reals_of(op, to2);
  params.parts = reals_of(op, sums);
  params.to_projections1 = reals_of(op, to_P);
  params.to_projections2 = reals_of(op, to_Q);
  KV_RUN(triangulate_backward, x, params, batch * parts, 1024 * (count < kSeenPart ? count : kSeenPart));
  KV_RUN(triangulate_sums, x, params, batch, 24 * parts);
  return {to1, to2, to_P, to_Q};
}

}  // namespace

#define KV_PICTURES "Tensor points1, Tensor points2, Tensor projections1, Tensor projections2"

KV_OPERATOR(triangulate, "(" KV_PICTURES ") -> Tensor")
KV_OPERATOR(triangulate_backward, "(Tensor grad, " KV_PICTURES ") -> (Tensor, Tensor, Tensor, Tensor)")

#undef KV_PICTURES

}  // namespace kv
