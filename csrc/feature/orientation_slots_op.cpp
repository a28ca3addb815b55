// Slots of orientations: schema and entry, for CPU and CUDA.
#include "glue/glue.h"
#include "orientation_slots.h"

namespace kv::feature {
namespace {

std::tuple<Tensor, Tensor> orientation_slots(Tensor const& laf, Tensor const& responses, Tensor const& angles) {
  constexpr char const* op = "orientation_slots";
  KV_CHECK(laf.dim() == 4 && laf.size(2) == 2 && laf.size(3) == 3 && laf.scalar_type() == compute_dtype(laf), op,
           ": expected laf of shape (B, N, 2, 3) of float32 or float64");
  int64_t const batch = laf.size(0), count = laf.size(1);
  KV_CHECK(count < INT32_MAX / 8 && batch <= INT32_MAX, op, ": expected less than 2^28 frames of a sample");
  auto const check = [&](char const* name, Tensor const& x, int64_t axes) {
    KV_CHECK(x.dim() == axes && x.size(0) == batch && x.size(1) == count && x.scalar_type() == laf.scalar_type() &&
                 x.device() == laf.device(),
             op, ": expected ", name, " of (B, N) frames, of their type");
  };
  check("responses", responses, 2);
  check("angles", angles, 3);
  int64_t const peaks = angles.size(2);
  KV_CHECK(peaks > 0 && peaks <= 1024, op, ": expected 1 to 1024 angles of a frame, got ", peaks);
  Tensor const x = dense(laf), r = dense(responses), a = dense(angles);
  Tensor const rotated = empty({batch, count, 2, 3}, x), scores = empty({batch, count}, x);
  auto const run = [&](auto type) {
    using F = typename decltype(type)::type;
    OrientationSlots<F> const params{data_ptr<F const>(x), data_ptr<F const>(r),
                                     data_ptr<F const>(a), data_ptr<F>(rotated),
                                     data_ptr<F>(scores),  batch,
                                     int(count),           int(peaks)};
    KV_RUN(orientation_slots, x, params, count > 0 ? batch : 0, 64 * count);
  };
  x.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return {rotated, scores};
}

}  // namespace

KV_OPERATOR(orientation_slots, "(Tensor laf, Tensor responses, Tensor angles) -> (Tensor, Tensor)")

}  // namespace kv::feature
