// The kernels of motion blur: schema and entry, for CPU and CUDA.
#include "glue/glue.h"
#include "motion.h"

namespace kv::filters {
namespace {

// `angle` (B or 1, 1) gives squares, (B or 1, 3) cubes; `direction` is (B or 1, 1).
Tensor motion_kernel(Tensor const& angle, Tensor const& direction, int64_t size, int64_t taps) {
  constexpr char const* op = "motion_kernel";
  KV_CHECK(size >= 3 && size < 1 << 15 && size % 2 == 1, op, ": expected an odd size of at least 3, got ", size);
  KV_CHECK(taps >= 0 && taps <= 2, op, ": unknown taps ", taps);
  KV_CHECK(
      angle.dim() == 2 && (angle.size(1) == 1 || angle.size(1) == 3) && direction.dim() == 2 && direction.size(1) == 1,
      op, ": expected angle (B, 1) or (B, 3) and direction (B, 1)");
  KV_CHECK(angle.scalar_type() == direction.scalar_type() && angle.device() == direction.device(), op,
           ": expected angle and direction of one type and device");
  int64_t const batch = angle.size(0) == 1 ? direction.size(0) : angle.size(0);
  KV_CHECK(direction.size(0) == 1 || direction.size(0) == batch, op, ": expected angle and direction of one length");
  Tensor const a = dense(angle), d = dense(direction);
  std::vector<int64_t> sizes{batch, size, size};
  if (angle.size(1) == 3) sizes.push_back(size);
  Tensor const kernels = empty(sizes, angle);
  dispatch_floating(op, angle, [&](auto type) {
    using T = typename decltype(type)::type;
    MotionKernel<T> const p{data_ptr<T>(a),         data_ptr<T>(d), a.size(0) == 1 ? 0 : a.size(1),
                            d.size(0) == 1 ? 0 : 1, int(size),      a.size(1) == 1 ? 2 : 3,
                            MotionTaps(taps),       batch,          data_ptr<T>(kernels)};
    KV_RUN(motion_kernel, angle, p, batch, 64 * p.count());
  });
  return kernels;
}

}  // namespace

KV_OPERATOR(motion_kernel, "(Tensor angle, Tensor direction, int size, int taps) -> Tensor")

}  // namespace kv::filters
