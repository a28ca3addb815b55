// The exact distance transform: schema and entry, for CPU and CUDA.
#include "distance_exact.h"
#include "glue/glue.h"

namespace kv::contrib {
namespace {

Tensor distance_transform_exact(Tensor const& input) {
  constexpr char const* op = "distance_transform_exact";
  bool const is_volume = input.dim() == 5;
  is_volume ? check_volumes(op, "input", input) : check_images(op, "input", input);
  bool const is_double = input.scalar_type() == ScalarType::Double;
  KV_CHECK(is_double || input.scalar_type() == ScalarType::Float, op, ": no kernel for this dtype");
  int64_t const depth = is_volume ? input.size(2) : 1, height = input.size(input.dim() - 2),
                width = input.size(input.dim() - 1);
  KV_CHECK(
      max(depth, max(height, width)) < 32768 && depth * depth + height * height + width * width <= int64_t(INT32_MAX),
      op, ": expected sides whose squares add up to less than 2^31");
  Tensor const x = dense(input), output = empty(input.sizes(), x);
  int64_t const planes = input.size(0) * input.size(1);
  // The squared distances of a pass and of the next, and the members of envelopes, two numbers each, which only CUDA
  // keeps in memory.
  auto const integers = [&](bool needed, ScalarType type) {
    return needed ? empty(input.sizes(), x, Layout::planar, type) : Tensor();
  };
  Tensor const squared = integers(true, ScalarType::Int), next = integers(is_volume, ScalarType::Int),
               kept = integers(x.is_cuda(), ScalarType::Long);
  int* const between = is_volume ? data_ptr<int>(next) : nullptr;
  Member* const members = x.is_cuda() ? reinterpret_cast<Member*>(data_ptr<int64_t>(kept)) : nullptr;
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    DistanceScan<T> const scan{data_ptr<T const>(x), planes * depth * height, width, data_ptr<int>(squared)};
    KV_RUN(distance_scan, x, scan, scan.rows, width);
    auto const pass = [&](int const* from, int64_t outer, int64_t length, int64_t inner, int* to) {
      DistanceEnvelope<T> const envelope{from, outer, length, inner, members, to, data_ptr<T>(output)};
      KV_RUN(distance_envelope, x, envelope, envelope.outer * ceil_div(inner, kLines), 8 * kLines * length);
    };
    pass(data_ptr<int>(squared), planes * depth, height, width, between);
    if (is_volume) pass(between, planes, depth, height * width, nullptr);
  };
  if (is_double)
    run(Type<double>{});
  else
    run(Type<float>{});
  return output;
}

}  // namespace

KV_OPERATOR(distance_transform_exact, "(Tensor input) -> Tensor")

}  // namespace kv::contrib
