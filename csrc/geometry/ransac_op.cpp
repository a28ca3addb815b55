// RANSAC's scores of models: schemas and entries, for CPU and CUDA.
#include <cmath>

#include "geometry/ransac.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

template <class F>
void dispatch_reals(Contiguous const& x, F f) {
  x.reals.is_double ? f(Type<double>{}) : f(Type<float>{});
}

void check_models(char const* op, char const* name, Tensor const& models) {
  KV_CHECK(models.dim() == 4 && models.size(2) == 3 && models.size(3) == 3, op, ": expected ", name,
           " of shape (B, M, 3, 3)");
}

// The `count` models with the best scores, ranked by the number of inliers or by the sum, and these scores: of models
// (B, M, 3, 3) for points (B, 2 or 4, N), and of those kept so far (B, L, 3, 3), whose scores (B, L, 2) are known. And
// the samples (B) that are required, of `existing` (B) correspondences, up to a budget.
std::tuple<Tensor, Tensor, Tensor> keep_best_models(Tensor const& models, Tensor const& points1, Tensor const& points2,
                                                    Tensor const& kept, Tensor const& kept_scores,
                                                    Tensor const& thresholds, Tensor const& existing, int64_t count,
                                                    bool by_count, int64_t model, double confidence, int64_t budget) {
  constexpr char const* op = "keep_best_models";
  Model const kind = parse_model(op, model);
  check_models(op, "models", models);
  check_models(op, "kept", kept);
  int64_t const batch = models.size(0), num_models = models.size(1), numbers = kind == Model::lines ? 4 : 2;
  KV_CHECK(points1.dim() == 3 && points1.size(0) == batch && points1.size(1) == numbers, op,
           ": expected points1 of shape (B, ", numbers, ", N)");
  check_like(op, "points2", points2, points1);
  KV_CHECK(kept.size(0) == batch, op, ": expected kept of as many pairs as models");
  KV_CHECK(kept_scores.dim() == 3 && kept_scores.size(0) == batch && kept_scores.size(1) == kept.size(1) &&
               kept_scores.size(2) == 2,
           op, ": expected kept_scores of shape (B, L, 2)");
  for (Tensor const* x : {&thresholds, &existing})
    KV_CHECK(x->dim() == 1 && x->size(0) == batch, op, ": expected thresholds and existing of shape (B)");
  for (Tensor const* x : {&points1, &kept, &kept_scores, &thresholds, &existing})
    KV_CHECK(x->scalar_type() == models.scalar_type() && x->device() == models.device(), op,
             ": expected all tensors of the dtype and device of models");
  KV_CHECK(num_models > 0 && count > 0, op, ": expected models, and a positive count");
  Contiguous const m(op, models), x(op, points1), y(op, points2), k(op, kept), s(op, kept_scores), t(op, thresholds),
      n(op, existing);
  int64_t const all = num_models + kept.size(1), top_k = count < all ? count : all;
  Tensor const scores = empty({batch, num_models, 2}, m.tensor);
  Tensor const top_models = empty({batch, top_k, 3, 3}, m.tensor), top_scores = empty({batch, top_k, 2}, m.tensor);
  Tensor const required = empty({batch}, m.tensor, Layout::planar, ScalarType::Long);
  dispatch_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    KeptModels<T> const before{data_ptr<T>(k.tensor), data_ptr<T>(s.tensor), kept.size(1)};
    Consensus<T> const consensus_of{data_ptr<T>(x.tensor),
                                    data_ptr<T>(y.tensor),
                                    data_ptr<T>(m.tensor),
                                    data_ptr<T>(t.tensor),
                                    before,
                                    before.count == count && !by_count,
                                    kind,
                                    batch,
                                    num_models,
                                    points1.size(2),
                                    data_ptr<T>(scores)};
    KV_RUN(consensus, m.tensor, consensus_of, batch * num_models, 4 * consensus_of.count);
    TopKModels<T> const ranks{consensus_of.models,
                              consensus_of.scores,
                              before,
                              batch,
                              num_models,
                              top_k,
                              by_count,
                              data_ptr<T>(n.tensor),
                              sample_size(kind),
                              std::log1p(-confidence),
                              budget,
                              data_ptr<T>(top_models),
                              data_ptr<T>(top_scores),
                              data_ptr<int64_t>(required)};
    KV_RUN(top_k_models, m.tensor, ranks, batch, top_k + all);
  });
  return {top_models, top_scores, required};
}

// The models (B, 3, 3), scaled and of the type of the points, and their inliers (B, N), of points (B, N, 2 or 4) and
// weights (B, N), of which positive ones exist. Both are 0 for pairs without a consensus.
std::tuple<Tensor, Tensor> select_inliers(Tensor const& points1, Tensor const& points2,
                                          std::optional<Tensor> const& weights, Tensor const& thresholds,
                                          Tensor const& models, int64_t model) {
  constexpr char const* op = "select_inliers";
  Model const kind = parse_model(op, model);
  int64_t const numbers = kind == Model::lines ? 4 : 2;
  KV_CHECK(points1.dim() == 3 && points1.size(2) == numbers, op, ": expected points1 of shape (B, N, ", numbers, ")");
  check_like(op, "points2", points2, points1);
  int64_t const batch = points1.size(0), count = points1.size(1);
  KV_CHECK(!weights || (weights->dim() == 2 && weights->size(0) == batch && weights->size(1) == count &&
                        weights->device() == points1.device()),
           op, ": expected weights of shape (B, N)");
  KV_CHECK(thresholds.dim() == 1 && thresholds.size(0) == batch && thresholds.device() == points1.device(), op,
           ": expected thresholds of shape (B)");
  KV_CHECK(models.dim() == 3 && models.size(0) == batch && models.size(1) == 3 && models.size(2) == 3 &&
               models.device() == points1.device(),
           op, ": expected models of shape (B, 3, 3)");
  Contiguous const x(op, points1), y(op, points2), w(op, weights), t(op, thresholds), m(op, models);
  Tensor const scaled = empty({batch, 3, 3}, x.tensor),
               inliers = empty({batch, count}, x.tensor, Layout::planar, ScalarType::Bool);
  Selection<double> const params{
      x.reals, y.reals, w.reals, t.reals, m.reals, kind, batch, count, reals_of(op, scaled), data_ptr<bool>(inliers)};
  KV_RUN(select_inliers, x.tensor, params, batch, 32 * count);
  return {scaled, inliers};
}

}  // namespace

KV_OPERATOR(select_inliers,
            "(Tensor points1, Tensor points2, Tensor? weights, Tensor thresholds, Tensor models, int model) -> "
            "(Tensor, Tensor)")
KV_OPERATOR(keep_best_models,
            "(Tensor models, Tensor points1, Tensor points2, Tensor kept, Tensor kept_scores, Tensor thresholds, "
            "Tensor existing, int count, bool by_count, int model, float confidence, int budget) -> "
            "(Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
