// Consensus: schema and entry, for CPU and CUDA alike.
#include "geometry/ransac.h"
#include "geometry/reals_glue.h"

namespace kv {
namespace {

// Points (2 or 4, N), and the threshold of their errors, for models (M, 3, 3).
template <class T>
Consensus<T> points_of(char const* op, Contiguous const& models, Contiguous const& points1, Contiguous const& points2,
                       double threshold, Model kind) {
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
void for_reals(Contiguous const& x, F f) {
  x.reals.wide ? f(Type<double>{}) : f(Type<float>{});
}

Tensor consensus(Tensor const& models, Tensor const& points1, Tensor const& points2, double threshold,
                 std::string const& model) {
  constexpr char const* op = "consensus";
  Contiguous const m(op, models), x(op, points1), y(op, points2);
  Tensor const scores = empty({models.size(0), 2}, m.tensor);
  for_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    auto params = points_of<T>(op, m, x, y, threshold, model_of(op, model));
    params.scores = static_cast<T*>(scores.mutable_data_ptr());
    KV_RUN(consensus, m.tensor, params, params.candidates, 4 * params.count);
  });
  return scores;
}

// The best `count` of two lists of models by their consensus, those with most who fit or those with the largest sum;
// that consensus; and the weights of the correspondences.
std::tuple<Tensor, Tensor, Tensor> contest(Tensor const& models, Tensor const& scores, Tensor const& others,
                                           Tensor const& other_scores, Tensor const& points1, Tensor const& points2,
                                           double threshold, double softness, int64_t count, bool by_number,
                                           std::string const& model) {
  constexpr char const* op = "contest";
  Contiguous const m(op, models), s(op, scores), n(op, others), t(op, other_scores), x(op, points1), y(op, points2);
  int64_t const total = models.size(0) + others.size(0), kept = count < total ? count : total;
  KV_CHECK(total > 0 && total <= 256 && count > 0, op, ": expected 1 to 256 models, and a positive count");
  for (Tensor const* list : {&others, &scores, &other_scores})
    KV_CHECK(list->scalar_type() == models.scalar_type() && list->device() == models.device(), op,
             ": models and scores differ in dtype or device");
  KV_CHECK(others.dim() == 3 && others.size(1) == 3 && others.size(2) == 3, op, ": expected others of shape (M, 3, 3)");
  auto const fits = [](Tensor const& scores, Tensor const& models) {
    return scores.dim() == 2 && scores.size(0) == models.size(0) && scores.size(1) == 2;
  };
  KV_CHECK(fits(scores, models) && fits(other_scores, others), op, ": expected scores of shape (M, 2)");
  Tensor const best = empty({kept, 3, 3}, m.tensor), best_scores = empty({kept, 2}, m.tensor);
  Tensor const weights = empty({kept, points1.size(1)}, m.tensor);
  for_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    auto const data = [](Tensor const& x) { return static_cast<T*>(const_cast<void*>(x.const_data_ptr())); };
    Contest<T> params{};
    static_cast<Consensus<T>&>(params) = points_of<T>(op, m, x, y, threshold, model_of(op, model));
    params.scores = data(s.tensor);
    params.others = data(n.tensor);
    params.other_scores = data(t.tensor);
    params.total = total;
    params.kept = kept;
    params.by_count = by_number;
    params.softness = T(softness);
    params.best = data(best);
    params.best_scores = data(best_scores);
    params.weights = data(weights);
    if (params.count > 0) KV_RUN(contest, m.tensor, params, kept, 4 * params.count);
  });
  return {best, best_scores, weights};
}

// The best `count` of models (M, 3, 3) by their consensus (M, 2): as contest has them.
std::tuple<Tensor, Tensor> leaders(Tensor const& models, Tensor const& scores, int64_t count, bool by_number) {
  constexpr char const* op = "leaders";
  KV_CHECK(models.dim() == 3 && models.size(1) == 3 && models.size(2) == 3, op, ": expected models of shape (M, 3, 3)");
  KV_CHECK(scores.dim() == 2 && scores.size(0) == models.size(0) && scores.size(1) == 2 &&
               scores.scalar_type() == models.scalar_type() && scores.device() == models.device(),
           op, ": expected scores of shape (M, 2), of the type and device of models");
  KV_CHECK(models.size(0) > 0 && count > 0, op, ": expected models, and a positive count");
  Contiguous const m(op, models), s(op, scores);
  int64_t const kept = count < models.size(0) ? count : models.size(0);
  Tensor const best = empty({kept, 3, 3}, m.tensor), best_scores = empty({kept, 2}, m.tensor);
  for_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    Leaders<T> const params{data_ptr<T>(m.tensor), data_ptr<T>(s.tensor),   models.size(0), kept, by_number,
                            data_ptr<T>(best),     data_ptr<T>(best_scores)};
    KV_RUN(leaders, m.tensor, params, 1, 0);
  });
  return {best, best_scores};
}

// The first of models (M, 3, 3) and which of N correspondences have a weight above 0 for it; nothing where these are
// `least` or fewer. Essential matrices have norm 1, other models a last number of 1.
std::tuple<Tensor, Tensor> verdict(Tensor const& models, Tensor const& weights, int64_t least,
                                   std::string const& model) {
  constexpr char const* op = "verdict";
  KV_CHECK(models.dim() == 3 && models.size(0) > 0 && models.size(1) == 3 && models.size(2) == 3, op,
           ": expected models of shape (M, 3, 3)");
  KV_CHECK(weights.dim() == 2 && weights.size(0) == models.size(0) && weights.scalar_type() == models.scalar_type() &&
               weights.device() == models.device(),
           op, ": expected weights of shape (M, N), of the type and device of models");
  Contiguous const m(op, models), w(op, weights);
  Tensor const found = empty({3, 3}, m.tensor);
  Tensor const fits = empty({weights.size(1)}, m.tensor, Layout::planar, ScalarType::Bool);
  for_reals(m, [&](auto type) {
    using T = typename decltype(type)::type;
    Verdict<T> const params{
        data_ptr<T>(m.tensor), data_ptr<T>(w.tensor), weights.size(1), least, model_of(op, model) == Model::essential,
        data_ptr<T>(found),    data_ptr<bool>(fits)};
    KV_RUN(verdict, m.tensor, params, 1, 0);
  });
  return {found, fits};
}

}  // namespace

KV_OPERATOR(leaders, "(Tensor models, Tensor scores, int count, bool by_number) -> (Tensor, Tensor)")
KV_OPERATOR(verdict, "(Tensor models, Tensor weights, int least, str model) -> (Tensor, Tensor)")
KV_OPERATOR(consensus, "(Tensor models, Tensor points1, Tensor points2, float threshold, str model) -> Tensor")
KV_OPERATOR(contest,
            "(Tensor models, Tensor scores, Tensor others, Tensor other_scores, Tensor points1, Tensor points2, "
            "float threshold, float softness, int count, bool by_number, str model) -> (Tensor, Tensor, Tensor)")

}  // namespace kv
