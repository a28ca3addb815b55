// Consensus: schema and entry, for CPU and CUDA alike.
#include "consensus.h"
#include "views_glue.h"

namespace kv {
namespace {

Tensor consensus(Tensor const& models, Tensor const& points1, Tensor const& points2, double threshold,
                 std::string const& model) {
  constexpr char const* op = "consensus";
  Model const kind = model_of(op, model);
  int64_t const numbers = kind == Model::lines ? 4 : 2;
  KV_CHECK(models.dim() == 3 && models.size(1) == 3 && models.size(2) == 3, op, ": expected models of shape (M, 3, 3)");
  KV_CHECK(points1.dim() == 2 && points1.size(0) == numbers, op, ": expected points1 of shape (", numbers, ", N)");
  check_like(op, "points2", points2, points1);
  KV_CHECK(points1.scalar_type() == models.scalar_type() && points1.device() == models.device(), op,
           ": points1 differs in dtype or device from models");
  Contiguous const m(op, models), x(op, points1), y(op, points2);
  Tensor const scores = empty({models.size(0), 2}, m.tensor);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    Consensus<T> const params{static_cast<T const*>(x.reals.data),
                              static_cast<T const*>(y.reals.data),
                              static_cast<T const*>(m.reals.data),
                              kind,
                              T(threshold * threshold),
                              models.size(0),
                              points1.size(1),
                              static_cast<T*>(scores.mutable_data_ptr())};
    KV_RUN(consensus, m.tensor, params, params.candidates, 4 * params.count);
  };
  m.reals.wide ? run(Type<double>{}) : run(Type<float>{});
  return scores;
}

}  // namespace

KV_OPERATOR(consensus, "(Tensor models, Tensor points1, Tensor points2, float threshold, str model) -> Tensor")

}  // namespace kv
