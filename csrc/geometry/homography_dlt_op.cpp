// Homographies from points: schemas and entries, for CPU and CUDA alike.
#include "homography_dlt.h"
#include "views_glue.h"

namespace kv {
namespace {

// The number of problems: that of weights, where one has the points of all.
int64_t checked_batch(char const* op, Tensor const& points1, Tensor const& points2,
                      std::optional<Tensor> const& weights) {
  KV_CHECK(points1.dim() == 3 && points1.size(2) == 2, op, ": expected points1 of shape (B, N, 2)");
  check_like(op, "points2", points2, points1);
  if (!weights) return points1.size(0);
  KV_CHECK(weights->dim() == 2 && (points1.size(0) == 1 || weights->size(0) == points1.size(0)) &&
               weights->size(1) == points1.size(1) && weights->device() == points1.device(),
           op, ": expected weights of shape (B, N) on the device of points1");
  return weights->size(0);
}

Tensor homography_dlt(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& weights) {
  constexpr char const* op = "homography_dlt";
  int64_t const batch = checked_batch(op, points1, points2, weights), count = points1.size(1);
  Contiguous const x(op, points1), y(op, points2), w(op, weights);
  Tensor const homography = empty({batch, 3, 3}, x.tensor);
  HomographyDlt<double> const params{
      x.reals, y.reals, w.reals, batch, count, points1.size(0) == 1 ? 0 : count, reals_of(op, homography),
      {},      {},      {},      {}};
  KV_RUN(homography_dlt, x.tensor, params, batch, 4096 + 64 * count);
  return homography;
}

std::tuple<Tensor, Tensor, Tensor> homography_dlt_backward(Tensor const& grad, Tensor const& points1,
                                                           Tensor const& points2,
                                                           std::optional<Tensor> const& weights) {
  constexpr char const* op = "homography_dlt_backward";
  int64_t const batch = checked_batch(op, points1, points2, weights), count = points1.size(1);
  KV_CHECK(points1.size(0) == batch, op, ": expected points of each problem");
  KV_CHECK(grad.dim() == 3 && grad.size(0) == batch && grad.size(1) == 3 && grad.size(2) == 3 &&
               grad.device() == points1.device(),
           op, ": expected grad of shape (B, 3, 3) on the device of points1");
  Contiguous const g(op, grad), x(op, points1), y(op, points2), w(op, weights);
  Tensor const grad1 = empty({batch, count, 2}, x.tensor), grad2 = empty({batch, count, 2}, x.tensor),
               grad_weights = empty({batch, count}, x.tensor);
  HomographyDlt<double> const params{x.reals,
                                     y.reals,
                                     w.reals,
                                     batch,
                                     count,
                                     count,
                                     {},
                                     g.reals,
                                     reals_of(op, grad1),
                                     reals_of(op, grad2),
                                     reals_of(op, grad_weights)};
  KV_RUN(homography_dlt_backward, x.tensor, params, batch, 16384 + 256 * count);
  return {grad1, grad2, grad_weights};
}

}  // namespace

KV_OPERATOR(homography_dlt, "(Tensor points1, Tensor points2, Tensor? weights) -> Tensor")
KV_OPERATOR(homography_dlt_backward,
            "(Tensor grad, Tensor points1, Tensor points2, Tensor? weights) -> (Tensor, Tensor, Tensor)")

}  // namespace kv
