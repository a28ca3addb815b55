// Lenses: schemas and entries, for CPU and CUDA alike.
#include "lens.h"
#include "views_glue.h"

namespace kv {
namespace {

// Points (B, N, 2); the numbers of their cameras are (B, ...), or (1, ...) for all. Runs a kernel, `run_kernel(points,
// params, count)`.
template <class Run>
Tensor through_lens(char const* op, Tensor const& points, Tensor const& camera, Tensor const& wanted,
                    Tensor const& coefficients, std::optional<Tensor> const& tilt, int64_t steps, Run run_kernel) {
  KV_CHECK(points.dim() == 3 && points.size(2) == 2, op, ": expected points of shape (B, N, 2)");
  KV_CHECK(steps >= 0 && steps <= INT32_MAX, op, ": expected steps of at least 0, got ", steps);
  int64_t const batch = points.size(0), count = points.size(1);
  auto const fits = [&](Tensor const& x) {
    return (x.size(0) == 1 || x.size(0) == batch) && x.scalar_type() == points.scalar_type() &&
           x.device() == points.device();
  };
  for (Tensor const* x : {&camera, &wanted, tilt ? &*tilt : &camera})
    KV_CHECK(x->dim() == 3 && x->size(1) == 3 && x->size(2) == 3 && fits(*x), op,
             ": expected matrices of shape (B, 3, 3) of the type and on the device of points");
  KV_CHECK(coefficients.dim() == 2 && coefficients.size(1) <= 14 && fits(coefficients), op,
           ": expected up to 14 coefficients (B, n) of the type and on the device of points");
  Contiguous const x(op, points), k(op, camera), w(op, wanted), c(op, coefficients), t(op, tilt);
  Tensor const result = empty({batch, count, 2}, x.tensor);
  auto const stride = [](Tensor const& x, int64_t size) { return x.size(0) == 1 ? int64_t(0) : size; };
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    auto const data = [](Contiguous const& x) { return static_cast<T const*>(x.reals.data); };
    int64_t const given = coefficients.size(1);
    LensPoints<T> const params{data(x),
                               data(k),
                               data(w),
                               data(c),
                               data(t),
                               stride(camera, 9),
                               stride(wanted, 9),
                               stride(coefficients, given),
                               tilt ? stride(*tilt, 9) : 0,
                               int(given),
                               int(steps),
                               batch,
                               count,
                               static_cast<T*>(result.mutable_data_ptr())};
    run_kernel(x.tensor, params, batch * count);
  };
  x.reals.wide ? run(Type<double>{}) : run(Type<float>{});
  return result;
}

Tensor undistort(Tensor const& points, Tensor const& camera, Tensor const& wanted, Tensor const& coefficients,
                 std::optional<Tensor> const& tilt, int64_t steps) {
  auto const run = [&]([[maybe_unused]] Tensor const& x, auto const& params, int64_t count) {
    KV_RUN(undistort, x, params, count, 4 * (1 + steps));
  };
  return through_lens("undistort", points, camera, wanted, coefficients, tilt, steps, run);
}

Tensor distort(Tensor const& points, Tensor const& camera, Tensor const& wanted, Tensor const& coefficients,
               std::optional<Tensor> const& tilt) {
  auto const run = [&]([[maybe_unused]] Tensor const& x, auto const& params, int64_t count) {
    KV_RUN(distort, x, params, count, 8);
  };
  return through_lens("distort", points, camera, wanted, coefficients, tilt, 0, run);
}

}  // namespace

#define KV_LENS "Tensor points, Tensor camera, Tensor wanted, Tensor coefficients, Tensor? tilt"

KV_OPERATOR(undistort, "(" KV_LENS ", int steps) -> Tensor")
KV_OPERATOR(distort, "(" KV_LENS ") -> Tensor")

#undef KV_LENS

}  // namespace kv
