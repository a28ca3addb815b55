// A step of the approximate distance transform: schema and entry, for CPU and CUDA.
#include "distance_step.h"
#include "glue/glue.h"

namespace kv::contrib {
namespace {

std::tuple<Tensor, Tensor> distance_transform_step(Tensor const& grown, Tensor const& total, Tensor const& kernel,
                                                   double distance, double h) {
  constexpr char const* op = "distance_transform_step";
  bool const is_volume = grown.dim() == 5;
  is_volume ? check_volumes(op, "grown", grown) : check_images(op, "grown", grown);
  check_like(op, "total", total, grown);
  KV_CHECK(grown.scalar_type() == ScalarType::Float || grown.scalar_type() == ScalarType::Double, op,
           ": no kernel for this dtype");
  int64_t const size = kernel.dim() == grown.dim() - 1 ? kernel.size(1) : 0;
  for (int64_t axis = 0; axis < kernel.dim(); ++axis)
    KV_CHECK(size % 2 == 1 && kernel.size(axis) == (axis == 0 ? 1 : size) && size <= kLargestWindow, op,
             ": expected a kernel of odd size, the same along all axes");
  KV_CHECK(size > 0 && kernel.scalar_type() == grown.scalar_type() && kernel.device() == grown.device(), op,
           ": expected a kernel of the axes, dtype and device of grown");
  int64_t const depth = is_volume ? grown.size(2) : 1, height = grown.size(grown.dim() - 2),
                width = grown.size(grown.dim() - 1);
  KV_CHECK(depth * height * width < int64_t(1) << 31, op, ": expected less than 2^31 pixels in an image");
  Tensor const x = dense(grown), sums = dense(total), weights = dense(kernel), next = empty(grown.sizes(), grown),
               next_total = empty(grown.sizes(), grown);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    int const radius = int(size / 2);
    DistanceStep<T> const params{data_ptr<T const>(x),
                                 data_ptr<T const>(sums),
                                 data_ptr<T const>(weights),
                                 grown.size(0) * grown.size(1),
                                 depth,
                                 height,
                                 width,
                                 radius,
                                 is_volume ? radius : 0,
                                 T(distance),
                                 T(-h),
                                 data_ptr<T>(next),
                                 data_ptr<T>(next_total)};
    KV_RUN(distance_step, x, params, params.planes * depth * height, weights.numel() * width);
  };
  if (grown.scalar_type() == ScalarType::Double)
    run(Type<double>{});
  else
    run(Type<float>{});
  return {next, next_total};
}

}  // namespace

KV_OPERATOR(distance_transform_step,
            "(Tensor grown, Tensor total, Tensor kernel, float distance, float h) -> (Tensor, Tensor)")

}  // namespace kv::contrib
