// Undistortion: schema and entry, for CPU and CUDA alike.
#include "undistort.h"
#include "views_glue.h"

namespace kv {
namespace {

Tensor undistort(Tensor const& points, Tensor const& cameras, int64_t steps, bool tilted) {
  constexpr char const* op = "undistort";
  KV_CHECK(points.dim() == 3 && points.size(2) == 2, op, ": expected points of shape (B, N, 2)");
  KV_CHECK(cameras.dim() == 2 && cameras.size(0) == points.size(0) && cameras.size(1) == kCameraNumbers &&
               cameras.scalar_type() == points.scalar_type() && cameras.device() == points.device(),
           op, ": expected cameras of shape (B, ", kCameraNumbers, ") of the type and on the device of points");
  KV_CHECK(steps >= 0 && steps <= INT32_MAX, op, ": expected steps of at least 0, got ", steps);
  Contiguous const x(op, points), c(op, cameras);
  int64_t const batch = points.size(0), count = points.size(1);
  Tensor const result = empty({batch, count, 2}, x.tensor);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    Undistort<T> const params{static_cast<T const*>(x.reals.data),
                              static_cast<T const*>(c.reals.data),
                              batch,
                              count,
                              int(steps),
                              tilted,
                              static_cast<T*>(result.mutable_data_ptr())};
    KV_RUN(undistort, x.tensor, params, batch * count, 4 * (1 + steps));
  };
  x.reals.wide ? run(Type<double>{}) : run(Type<float>{});
  return result;
}

}  // namespace

KV_OPERATOR(undistort, "(Tensor points, Tensor cameras, int steps, bool tilted) -> Tensor")

}  // namespace kv
