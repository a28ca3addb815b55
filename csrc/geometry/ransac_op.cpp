// RANSAC's scores of models: schemas and entries, for CPU and CUDA.
#include "geometry/ransac.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

template <class F>
void dispatch_reals(Contiguous const& x, F f) {
  x.reals.is_double ? f(Type<double>{}) : f(Type<float>{});
}

void check_models(char const* op, Tensor const& models) {
  KV_CHECK(models.dim() == 4 && models.size(2) == 3 && models.size(3) == 3, op,
           ": expected models of shape (B, M, 3, 3)");
}

// Scores (B, M, 2) of models (B, M, 3, 3) for points (B, 2 or 4, N), of which sums below `least` (B) are not needed.
Tensor consensus(Tensor const& models, Tensor const& points1, Tensor const& points2, Tensor const& least,
                 Tensor const& thresholds, int64_t model) {
  constexpr char const* op = "consensus";
  Model const kind = parse_model(op, model);
  check_models(op, models);
  int64_t const batch = models.size(0), numbers = kind == Model::lines ? 4 : 2;
  KV_CHECK(points1.dim() == 3 && points1.size(0) == batch && points1.size(1) == numbers, op,
           ": expected points1 of shape (B, ", numbers, ", N)");
  check_like(op, "points2", points2, points1);
  KV_CHECK(least.dim() == 1 && least.size(0) == batch, op, ": expected least of shape (B)");
  check_like(op, "thresholds", thresholds, least);
  for (Tensor const* x : {&points1, &least})
    KV_CHECK(x->scalar_type() == models.scalar_type() && x->device() == models.device(), op,
             ": points1 or least differs in dtype or device from models");
  Contiguous const m(op, models), x(op, points1), y(op, points2), l(op, least), t(op, thresholds);
  Tensor const scores = empty({batch, models.size(1), 2}, m.tensor);
  dispatch_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    Consensus<T> const params{data_ptr<T>(x.tensor),
                              data_ptr<T>(y.tensor),
                              data_ptr<T>(m.tensor),
                              data_ptr<T>(l.tensor),
                              data_ptr<T>(t.tensor),
                              kind,
                              batch,
                              models.size(1),
                              points1.size(2),
                              data_ptr<T>(scores)};
    KV_RUN(consensus, m.tensor, params, batch * params.num_models, 4 * params.count);
  });
  return scores;
}

// The `count` models of (B, M, 3, 3) with the best scores (B, M, 2), ranked by the number of inliers or by the sum, and
// these scores.
std::tuple<Tensor, Tensor> top_k_models(Tensor const& models, Tensor const& scores, int64_t count, bool by_count) {
  constexpr char const* op = "top_k_models";
  check_models(op, models);
  int64_t const batch = models.size(0), num_models = models.size(1);
  KV_CHECK(scores.dim() == 3 && scores.size(0) == batch && scores.size(1) == num_models && scores.size(2) == 2 &&
               scores.scalar_type() == models.scalar_type() && scores.device() == models.device(),
           op, ": expected scores of shape (B, M, 2), of the type and device of models");
  KV_CHECK(num_models > 0 && count > 0, op, ": expected models, and a positive count");
  Contiguous const m(op, models), s(op, scores);
  int64_t const top_k = count < num_models ? count : num_models;
  Tensor const top_models = empty({batch, top_k, 3, 3}, m.tensor), top_scores = empty({batch, top_k, 2}, m.tensor);
  dispatch_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    TopKModels<T> const params{data_ptr<T>(m.tensor),   data_ptr<T>(s.tensor),  batch, num_models, top_k, by_count,
                               data_ptr<T>(top_models), data_ptr<T>(top_scores)};
    KV_RUN(top_k_models, m.tensor, params, batch, top_k * num_models);
  });
  return {top_models, top_scores};
}

}  // namespace

KV_OPERATOR(top_k_models, "(Tensor models, Tensor scores, int count, bool by_count) -> (Tensor, Tensor)")
KV_OPERATOR(consensus,
            "(Tensor models, Tensor points1, Tensor points2, Tensor least, Tensor thresholds, int model) -> Tensor")

}  // namespace kv::geometry
