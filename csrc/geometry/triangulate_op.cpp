// Triangulation: schema and entry, for CPU and CUDA alike.
#include "triangulate.h"
#include "views_glue.h"

namespace kv {
namespace {

Tensor triangulate(Tensor const& points1, Tensor const& points2, Tensor const& projections1,
                   Tensor const& projections2) {
  constexpr char const* op = "triangulate";
  KV_CHECK(points1.dim() == 3 && points1.size(2) == 2, op, ": expected points1 of shape (B, N, 2)");
  check_like(op, "points2", points2, points1);
  int64_t const batch = points1.size(0), count = points1.size(1);
  KV_CHECK(projections1.dim() == 3 && projections1.size(0) == batch && projections1.size(1) == 3 &&
               projections1.size(2) == 4 && projections1.device() == points1.device(),
           op, ": expected projections1 of shape (B, 3, 4) on the device of points1");
  check_like(op, "projections2", projections2, projections1);
  Contiguous const x(op, points1), y(op, points2), P(op, projections1), Q(op, projections2);
  Tensor const points = empty({batch, count, 3}, x.tensor);
  double const least = least_share(x);
  Triangulate<double> const params{x.reals, y.reals, P.reals, Q.reals, batch, count, least, reals_of(op, points)};
  KV_RUN(triangulate, x.tensor, params, batch * count, 256);
  return points;
}

}  // namespace

KV_OPERATOR(triangulate, "(Tensor points1, Tensor points2, Tensor projections1, Tensor projections2) -> Tensor")

}  // namespace kv
