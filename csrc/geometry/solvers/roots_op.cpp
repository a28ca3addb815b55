// Real roots: schema and entry, for CPU and CUDA.
#include "geometry/reals_glue.h"
#include "geometry/solvers/roots.h"

namespace kv::geometry {
namespace {

Tensor real_roots(Tensor const& coefficients) {
  constexpr char const* op = "real_roots";
  KV_CHECK(coefficients.dim() == 2, op, ": expected coefficients of shape (B, n + 1)");
  int64_t const batch = coefficients.size(0), degree = coefficients.size(1) - 1;
  KV_CHECK(degree >= 1 && degree <= small::kMaxRoots, op, ": expected a degree of 1 to ", small::kMaxRoots, ", got ",
           degree);
  Contiguous const c(op, coefficients);
  Tensor const roots = empty({batch, degree}, c.tensor);
  RealRoots<double> const params{c.reals, batch, int(degree), reals_of(op, roots)};
  KV_RUN(real_roots, c.tensor, params, batch, 64 * degree * degree);
  return roots;
}

Tensor first_root(Tensor const& coefficients) {
  constexpr char const* op = "first_root";
  KV_CHECK(coefficients.dim() == 2, op, ": expected coefficients of shape (B, n + 1)");
  int64_t const batch = coefficients.size(0), degree = coefficients.size(1) - 1;
  KV_CHECK(degree >= 0 && degree <= kMaxFirstRootDegree, op, ": expected a degree of at most ", kMaxFirstRootDegree,
           ", got ", degree);
  Contiguous const c(op, coefficients);
  Tensor const root = empty({batch}, c.tensor);
  RealRoots<double> const params{c.reals, batch, int(degree), reals_of(op, root)};
  KV_RUN(first_root, c.tensor, params, batch, 1024);
  return root;
}

}  // namespace

KV_OPERATOR(real_roots, "(Tensor coefficients) -> Tensor")
KV_OPERATOR(first_root, "(Tensor coefficients) -> Tensor")

}  // namespace kv::geometry
