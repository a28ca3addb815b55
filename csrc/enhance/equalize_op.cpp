// Histogram equalization: schema and entry, for CPU and CUDA.
#include "equalize.h"
#include "plane_views.h"

namespace kv::enhance {
namespace {

std::tuple<Tensor, Tensor> equalize(Tensor const& input, bool opencv) {
  check_planes("equalize", input);
  Layout const layout = layout_of(input);
  Tensor const x = dense_planes(input, layout), y = empty_like(x, layout), changed = empty({x.size(0), x.size(1)}, x);
  int64_t const planes = x.size(0) * x.size(1);
#if defined(KV_CUDA)
  int64_t const parts = 1;
#else
  int64_t const pixels = x.size(2) * x.size(3);
  int64_t const parts = planes < kManyPlanes ? max(int64_t(1), pixels / kLargePlane) : 1;
#endif
  Tensor const memory = empty({planes * parts, kLevels}, x, Layout::planar, ScalarType::Int);
  dispatch_floating_and_uint8("equalize", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Equalize<T> const params{flat_planes<T const>(x, layout),
                             flat_planes<T>(y, layout),
                             static_cast<T*>(changed.mutable_data_ptr()),
                             opencv,
                             static_cast<int32_t*>(memory.mutable_data_ptr()),
                             parts};
#if !defined(KV_CUDA)
    if (parts > 1) KV_RUN(equalize_counts, x, params, planes * parts, kLargePlane);
#endif
    KV_RUN(equalize, x, params, planes * parts, 2 * pixels / parts);
  });
  return {y, changed};
}

// `changed`, if it has data, is the Change per plane that equalize stored; output is its result.
Tensor equalize_backward(Tensor const& grad, Tensor const& output, std::optional<Tensor> const& changed) {
  char const* const op = "equalize_backward";
  check_planes(op, grad);
  check_like(op, "output", output, grad);
  KV_CHECK(!changed || (changed->dim() == 2 && changed->size(0) == grad.size(0) && changed->size(1) == grad.size(1) &&
                        changed->scalar_type() == grad.scalar_type() && changed->device() == grad.device()),
           op, ": expected what equalize result of each plane, of the type of grad");
  Layout const layout = layout_of(output);
  Tensor const y = dense_planes(output, layout), grad_x = empty_like(y, layout);
  Tensor const g = dense_planes(as_layout(grad, layout), layout), result = changed ? dense(*changed) : y;
  dispatch_floating(op, grad, [&](auto type) {
    using T = typename decltype(type)::type;
    EqualizeBackward<T> const params{flat_planes<T const>(g, layout), flat_planes<T const>(y, layout),
                                     flat_planes<T>(grad_x, layout),
                                     changed ? static_cast<T const*>(result.const_data_ptr()) : nullptr};
    KV_RUN(equalize_backward, grad, params, params.grad.count(), params.grad.width);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(equalize, "(Tensor input, bool opencv) -> (Tensor output, Tensor changed)")
KV_OPERATOR(equalize_backward, "(Tensor grad, Tensor output, Tensor? changed) -> Tensor")

}  // namespace kv::enhance
