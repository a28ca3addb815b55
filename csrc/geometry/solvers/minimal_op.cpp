// Minimal solvers: schema and entry, for CPU and CUDA.
#include "geometry/reals_glue.h"
#include "geometry/solvers/minimal.h"

namespace kv::geometry {
namespace {

Tensor minimal_solver(Tensor const& points1, Tensor const& points2, std::optional<Tensor> const& draws, int64_t model) {
  constexpr char const* op = "minimal_solver";
  Model const kind = parse_model(op, model);
  int64_t const size = sample_size(kind), numbers = kind == Model::lines ? 4 : 2;
  KV_CHECK(points1.dim() == 3 && points1.size(2) == numbers, op, ": expected points1 of shape (B, N, ", numbers, ")");
  check_like(op, "points2", points2, points1);
  int64_t const pairs = points1.size(0) > 0 ? points1.size(0) : 1;
  KV_CHECK(!draws || (draws->dim() == 2 && draws->size(1) == size + 1 && draws->size(0) % pairs == 0 &&
                      draws->device() == points1.device() && points1.size(1) >= size),
           op, ": expected draws of shape (S, ", size + 1, ") for points (B, N, ", numbers, "), S a multiple of B");
  KV_CHECK(draws || points1.size(1) == size, op, ": expected ", size, " points a sample");
  int64_t const samples = draws ? draws->size(0) : points1.size(0);
  Contiguous const x(op, points1), y(op, points2), u(op, draws);
  Tensor const models = empty({samples, candidates(kind), 3, 3}, x.tensor);
  Minimal<double> const params{x.reals, y.reals,         u.reals,         kind,
                               samples, samples / pairs, points1.size(1), reals_of(op, models)};
  KV_RUN(minimal_solver, x.tensor, params, samples,
         kind == Model::essential    ? 16384
         : kind == Model::homography ? 64
                                     : 1024);
  return models;
}

}  // namespace

KV_OPERATOR(minimal_solver, "(Tensor points1, Tensor points2, Tensor? draws, int model) -> Tensor")

}  // namespace kv::geometry
