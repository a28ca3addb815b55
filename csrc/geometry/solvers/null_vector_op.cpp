// Null vectors: schemas and entries, for CPU and CUDA.
#include "geometry/reals_glue.h"
#include "geometry/solvers/null_vector.h"

namespace kv::geometry {
namespace {

void check_rows(char const* op, Tensor const& rows) {
  KV_CHECK(rows.dim() == 3, op, ": expected rows of shape (B, m, n)");
  int64_t const n = rows.size(2);
  KV_CHECK(n == 3 || n == 4 || n == 9 || n == 12, op, ": expected rows of 3, 4, 9 or 12 numbers, got ", n);
}

void check(char const* op, Tensor const& rows, std::optional<Tensor> const& weights) {
  check_rows(op, rows);
  KV_CHECK(!weights || (weights->dim() == 2 && weights->size(0) == rows.size(0) && weights->size(1) == rows.size(1) &&
                        weights->device() == rows.device()),
           op, ": expected weights of shape (B, m) on the device of rows");
}

Tensor null_vector(Tensor const& rows, std::optional<Tensor> const& weights) {
  constexpr char const* op = "null_vector";
  check(op, rows, weights);
  Contiguous const r(op, rows), w(op, weights);
  int64_t const batch = rows.size(0), m = rows.size(1), n = rows.size(2);
  Tensor const vector = empty({batch, n}, r.tensor);
  NullVector<double> const params{r.reals, w.reals, batch, m, int(n), reals_of(op, vector), {}, {}, {}};
  KV_RUN(null_vector, r.tensor, params, batch, m * n * n + 8 * n * n * n);
  return vector;
}

std::tuple<Tensor, Tensor> null_vector_backward(Tensor const& grad, Tensor const& vector, Tensor const& rows,
                                                std::optional<Tensor> const& weights) {
  constexpr char const* op = "null_vector_backward";
  check(op, rows, weights);
  int64_t const batch = rows.size(0), m = rows.size(1), n = rows.size(2);
  KV_CHECK(vector.dim() == 2 && vector.size(0) == batch && vector.size(1) == n && vector.device() == rows.device(), op,
           ": expected vector of shape (B, n) on the device of rows");
  check_like(op, "grad", grad, vector);
  Contiguous const g(op, grad), v(op, vector), r(op, rows), w(op, weights);
  Tensor const grad_rows = empty({batch, m, n}, r.tensor), grad_weights = empty({batch, m}, r.tensor);
  NullVector<double> const params{
      r.reals, w.reals, batch, m, int(n), v.reals, g.reals, reals_of(op, grad_rows), reals_of(op, grad_weights)};
  KV_RUN(null_vector_backward, r.tensor, params, batch, 2 * m * n * n + 2 * n * n * n);
  return {grad_rows, grad_weights};
}

std::tuple<Tensor, Tensor> eigenvectors(Tensor const& matrix) {
  constexpr char const* op = "eigenvectors";
  check_rows(op, matrix);
  int64_t const batch = matrix.size(0), n = matrix.size(2);
  KV_CHECK(matrix.size(1) == n, op, ": expected square matrices");
  Contiguous const m(op, matrix);
  Tensor const values = empty({batch, n}, m.tensor), vectors = empty({batch, n, n}, m.tensor);
  Eigenvectors<double> const params{m.reals, batch, int(n), reals_of(op, values), reals_of(op, vectors)};
  KV_RUN(eigenvectors, m.tensor, params, batch, 64 * n * n * n);
  return {values, vectors};
}

}  // namespace

KV_OPERATOR(null_vector, "(Tensor rows, Tensor? weights) -> Tensor")
KV_OPERATOR(null_vector_backward, "(Tensor grad, Tensor vector, Tensor rows, Tensor? weights) -> (Tensor, Tensor)")
KV_OPERATOR(eigenvectors, "(Tensor matrix) -> (Tensor, Tensor)")

}  // namespace kv::geometry
