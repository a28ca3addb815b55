// RANSAC's scores of models: schemas and entries, for CPU and CUDA.
#include "geometry/ransac.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// Points (2 or 4, N) and the threshold of their errors, for models (M, 3, 3), checked.
template <class T>
Consensus<T> consensus_params(char const* op, Contiguous const& models, Contiguous const& points1,
                              Contiguous const& points2, double threshold, Model kind) {
  Tensor const &m = models.tensor, &x = points1.tensor;
  KV_CHECK(m.dim() == 3 && m.size(1) == 3 && m.size(2) == 3, op, ": expected models of shape (M, 3, 3)");
  int64_t const numbers = kind == Model::lines ? 4 : 2;
  KV_CHECK(x.dim() == 2 && x.size(0) == numbers, op, ": expected points1 of shape (", numbers, ", N)");
  check_like(op, "points2", points2.tensor, x);
  KV_CHECK(x.scalar_type() == m.scalar_type() && x.device() == m.device(), op,
           ": points1 differs in dtype or device from models");
  auto const data = [](Contiguous const& t) { return static_cast<T const*>(t.reals.data); };
  return {data(points1), data(points2), data(models), kind, T(threshold * threshold), m.size(0), x.size(1), nullptr};
}

template <class F>
void dispatch_reals(Contiguous const& x, F f) {
  x.reals.is_double ? f(Type<double>{}) : f(Type<float>{});
}

Tensor consensus(Tensor const& models, Tensor const& points1, Tensor const& points2, double threshold, int64_t model) {
  constexpr char const* op = "consensus";
  Contiguous const m(op, models), x(op, points1), y(op, points2);
  Tensor const scores = empty({models.size(0), 2}, m.tensor);
  dispatch_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    auto params = consensus_params<T>(op, m, x, y, threshold, parse_model(op, model));
    params.scores = static_cast<T*>(scores.mutable_data_ptr());
    KV_RUN(consensus, m.tensor, params, params.num_models, 4 * params.count);
  });
  return scores;
}

// The best `count` models of two lists, ranked by the number of inliers or by the sum; their scores; and the weights of
// the correspondences.
std::tuple<Tensor, Tensor, Tensor> merge_top_k(Tensor const& models, Tensor const& scores, Tensor const& other_models,
                                               Tensor const& other_scores, Tensor const& points1, Tensor const& points2,
                                               double threshold, double softness, int64_t count, bool by_count,
                                               int64_t model) {
  constexpr char const* op = "merge_top_k";
  Contiguous const m(op, models), s(op, scores), n(op, other_models), t(op, other_scores), x(op, points1),
      y(op, points2);
  int64_t const num_candidates = models.size(0) + other_models.size(0),
                top_k = count < num_candidates ? count : num_candidates;
  KV_CHECK(num_candidates > 0 && num_candidates <= 256 && count > 0, op,
           ": expected 1 to 256 models, and a positive count");
  for (Tensor const* list : {&other_models, &scores, &other_scores})
    KV_CHECK(list->scalar_type() == models.scalar_type() && list->device() == models.device(), op,
             ": models and scores differ in dtype or device");
  KV_CHECK(other_models.dim() == 3 && other_models.size(1) == 3 && other_models.size(2) == 3, op,
           ": expected other_models of shape (M, 3, 3)");
  auto const has_scores_shape = [](Tensor const& scores, Tensor const& models) {
    return scores.dim() == 2 && scores.size(0) == models.size(0) && scores.size(1) == 2;
  };
  KV_CHECK(has_scores_shape(scores, models) && has_scores_shape(other_scores, other_models), op,
           ": expected scores of shape (M, 2)");
  Tensor const top_models = empty({top_k, 3, 3}, m.tensor), top_scores = empty({top_k, 2}, m.tensor);
  Tensor const weights = empty({top_k, points1.size(1)}, m.tensor);
  dispatch_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    auto const data = [](Tensor const& x) { return static_cast<T*>(const_cast<void*>(x.const_data_ptr())); };
    MergeTopK<T> params{};
    static_cast<Consensus<T>&>(params) = consensus_params<T>(op, m, x, y, threshold, parse_model(op, model));
    params.scores = data(s.tensor);
    params.other_models = data(n.tensor);
    params.other_scores = data(t.tensor);
    params.num_candidates = num_candidates;
    params.top_k = top_k;
    params.by_count = by_count;
    params.softness = T(softness);
    params.top_models = data(top_models);
    params.top_scores = data(top_scores);
    params.weights = data(weights);
    if (params.count > 0) KV_RUN(merge_top_k, m.tensor, params, top_k, 4 * params.count);
  });
  return {top_models, top_scores, weights};
}

// The `count` models (M, 3, 3) with the best scores (M, 2), and these scores.
std::tuple<Tensor, Tensor> top_k_models(Tensor const& models, Tensor const& scores, int64_t count, bool by_count) {
  constexpr char const* op = "top_k_models";
  KV_CHECK(models.dim() == 3 && models.size(1) == 3 && models.size(2) == 3, op, ": expected models of shape (M, 3, 3)");
  KV_CHECK(scores.dim() == 2 && scores.size(0) == models.size(0) && scores.size(1) == 2 &&
               scores.scalar_type() == models.scalar_type() && scores.device() == models.device(),
           op, ": expected scores of shape (M, 2), of the type and device of models");
  KV_CHECK(models.size(0) > 0 && count > 0, op, ": expected models, and a positive count");
  Contiguous const m(op, models), s(op, scores);
  int64_t const top_k = count < models.size(0) ? count : models.size(0);
  Tensor const top_models = empty({top_k, 3, 3}, m.tensor), top_scores = empty({top_k, 2}, m.tensor);
  dispatch_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    TopKModels<T> const params{data_ptr<T>(m.tensor),   data_ptr<T>(s.tensor),  models.size(0), top_k, by_count,
                               data_ptr<T>(top_models), data_ptr<T>(top_scores)};
    KV_RUN(top_k_models, m.tensor, params, 1, 0);
  });
  return {top_models, top_scores};
}

}  // namespace

KV_OPERATOR(top_k_models, "(Tensor models, Tensor scores, int count, bool by_count) -> (Tensor, Tensor)")
KV_OPERATOR(consensus, "(Tensor models, Tensor points1, Tensor points2, float threshold, int model) -> Tensor")
KV_OPERATOR(merge_top_k,
            "(Tensor models, Tensor scores, Tensor other_models, Tensor other_scores, Tensor points1, Tensor points2, "
            "float threshold, float softness, int count, bool by_count, int model) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
