// Errors of correspondences: schemas and entries, for CPU and CUDA alike.
#include "geometry/correspondence_errors.h"
#include "geometry/reals_glue.h"

namespace kv {
namespace {

// Correspondences that are summed before anything else is.
constexpr int64_t kErrorsPart = 2048;

ViewError view_error_of_name(char const* op, std::string const& name) {
  constexpr char const* names[] = {"sampson",          "symmetrical", "right", "left", "transfer", "symmetric_transfer",
                                   "sampson_transfer", "segments"};
  for (int i = 0; i < 8; ++i)
    if (name == names[i]) return ViewError(i);
  fail({op,
        ": kind must be one of sampson, symmetrical, right, left, transfer, symmetric_transfer, sampson_transfer, "
        "segments; got '",
        name, "'"});
}

// Points and matrices, checked; one of each serves a batch.
struct GivenRelations {
  Contiguous points1, points2, matrix;
  ViewErrors<double> params{};

  GivenRelations(char const* op, Tensor const& x, Tensor const& y, Tensor const& m, std::string const& kind,
                 bool squared)
      : points1(op, x), points2(op, y), matrix(op, m) {
    params.kind = view_error_of_name(op, kind);
    params.squared = squared;
    params.batch = 1;
    int64_t const least = params.kind == ViewError::segments ? 4 : 2, most = least == 4 ? 4 : 3;
    for (Tensor const* t : {&x, &y})
      KV_CHECK(t->dim() == 3 && t->size(1) == x.size(1) && t->size(2) >= least && t->size(2) <= most, op,
               ": expected points of shape (B, N, ", least, most > least ? " or 3)" : ")");
    KV_CHECK(m.dim() == 3 && m.size(1) == 3 && m.size(2) == 3, op, ": expected matrix of shape (B, 3, 3)");
    for (Tensor const* t : {&x, &y, &m}) {
      KV_CHECK(t->device() == x.device(), op, ": expected all on one device");
      KV_CHECK(params.batch == 1 || t->size(0) == 1 || t->size(0) == params.batch, op,
               ": expected batches of one size or 1");
      if (t->size(0) != 1) params.batch = t->size(0);
    }
    auto const stride = [](Tensor const& t) { return t.size(0) == 1 ? 0 : t.size(1) * t.size(2); };
    params.points1 = points1.reals;
    params.points2 = points2.reals;
    params.matrix = matrix.reals;
    params.axes1 = int(x.size(2));
    params.axes2 = int(y.size(2));
    params.problem1 = stride(x);
    params.problem2 = stride(y);
    params.problem_matrix = stride(m);
    params.count = x.size(1);
    params.part = kErrorsPart;
    params.rounding = matrix.reals.wide ? 2.220446049250313e-16 : 1.1920928955078125e-07;
    params.largest = points1.reals.wide ? 1.7976931348623157e308 : 3.4028234663852886e38;
  }
};

Tensor view_errors(Tensor const& points1, Tensor const& points2, Tensor const& matrix, std::string const& kind,
                   bool squared) {
  constexpr char const* op = "view_errors";
  GivenRelations given(op, points1, points2, matrix, kind, squared);
  ViewErrors<double>& params = given.params;
  Tensor const errors = empty({params.batch, params.count}, given.points1.tensor);
  params.errors = reals_of(op, errors);
  KV_RUN(view_errors, errors, params, params.batch * params.count, 32);
  return errors;
}

// For each problem, also where one of the three serves all.
std::tuple<Tensor, Tensor, Tensor> view_errors_backward(Tensor const& grad, Tensor const& points1,
                                                        Tensor const& points2, Tensor const& matrix,
                                                        std::string const& kind, bool squared) {
  constexpr char const* op = "view_errors_backward";
  GivenRelations given(op, points1, points2, matrix, kind, squared);
  ViewErrors<double>& params = given.params;
  int64_t const batch = params.batch, count = params.count;
  KV_CHECK(grad.dim() == 2 && grad.size(0) == batch && grad.size(1) == count && grad.device() == points1.device(), op,
           ": expected grad of shape (B, N) on the device of points1");
  Contiguous const g(op, grad);
  Tensor const to1 = empty({batch, count, params.axes1}, given.points1.tensor);
  Tensor const to2 = empty({batch, count, params.axes2}, given.points1.tensor);
  Tensor const to_matrix = empty({batch, 3, 3}, given.points1.tensor);
  int64_t const parts = params.part_count();
  Tensor const sums =
      parts == 1 ? to_matrix : empty({batch, parts, 9}, given.points1.tensor, Layout::planar, ScalarType::Double);
  params.grad = g.reals;
  params.to1 = reals_of(op, to1);
  params.to2 = reals_of(op, to2);
  params.to_matrix = reals_of(op, to_matrix);
  params.parts = reals_of(op, sums);
  KV_RUN(view_errors_backward, to1, params, batch * parts, 128 * (count < kErrorsPart ? count : kErrorsPart));
  if (parts != 1) KV_RUN(view_errors_sums, to1, params, batch, 9 * parts);
  return {to1, to2, to_matrix};
}

}  // namespace

#define KV_RELATED "Tensor points1, Tensor points2, Tensor matrix, str kind, bool squared"

KV_OPERATOR(view_errors, "(" KV_RELATED ") -> Tensor")
KV_OPERATOR(view_errors_backward, "(Tensor grad, " KV_RELATED ") -> (Tensor, Tensor, Tensor)")

#undef KV_RELATED

}  // namespace kv
