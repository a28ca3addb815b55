// Fits of two views: schema and entry, for CPU and CUDA.
#include "geometry/reals_glue.h"
#include "geometry/solvers/two_view_fits.h"

namespace kv::geometry {
namespace {

std::tuple<Tensor, Tensor> two_view_fits(Tensor const& models, Tensor const& points1, Tensor const& points2,
                                         std::optional<Tensor> const& weights, Tensor const& reaches, int64_t rounds,
                                         int64_t model, bool adapts) {
  constexpr char const* op = "two_view_fits";
  Model const kind = parse_model(op, model);
  KV_CHECK(kind != Model::lines, op, ": no kernel for lines");
  KV_CHECK(!adapts || kind == Model::fundamental || kind == Model::fundamental8, op,
           ": expected a fundamental matrix for fits that adapt");
  KV_CHECK(models.dim() == 4 && models.size(2) == 3 && models.size(3) == 3, op,
           ": expected models of shape (B, K, 3, 3)");
  int64_t const batch = models.size(0), num_models = models.size(1);
  KV_CHECK(points1.dim() == 3 && points1.size(0) == batch && points1.size(1) == 2, op,
           ": expected points1 of shape (B, 2, N)");
  check_like(op, "points2", points2, points1);
  int64_t const count = points1.size(2);
  KV_CHECK(!weights || (weights->dim() == 2 && weights->size(0) == batch && weights->size(1) == count), op,
           ": expected weights of shape (B, N)");
  KV_CHECK(reaches.dim() == 1 && reaches.size(0) == batch, op, ": expected reaches of shape (B)");
  Contiguous const m(op, models), x(op, points1), y(op, points2), w(op, weights), r(op, reaches);
  for (Contiguous const* t : {&m, &x, &y, &w, &r})
    KV_CHECK(!t->reals.data || (t->reals.is_double && t->tensor.device() == models.device()), op,
             ": expected float64 tensors of one device");
  Tensor const fitted = empty({batch, num_models, 3, 3}, m.tensor), scores = empty({batch, num_models}, m.tensor);
  auto const data = [](Contiguous const& t) { return static_cast<double const*>(t.reals.data); };
  TwoViewFits<double> const params{data(m),
                                   data(x),
                                   data(y),
                                   data(w),
                                   data(r),
                                   kind,
                                   rounds,
                                   batch,
                                   num_models,
                                   count,
                                   adapts,
                                   data_ptr<double>(fitted),
                                   data_ptr<double>(scores)};
  KV_RUN(two_view_fits, m.tensor, params, batch * num_models, (rounds + 1) * (16 * count + 4096));
  return {fitted, scores};
}

}  // namespace

KV_OPERATOR(two_view_fits,
            "(Tensor models, Tensor points1, Tensor points2, Tensor? weights, Tensor reaches, int rounds, int model, "
            "bool adapts) -> (Tensor, Tensor)")

}  // namespace kv::geometry
