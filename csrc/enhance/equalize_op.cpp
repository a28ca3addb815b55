// Equalisation: schema and entry, for CPU and CUDA alike.
#include "equalize.h"
#include "flat_glue.h"

namespace kv {
namespace {

std::tuple<Tensor, Tensor> equalize(Tensor const& input, bool opencv) {
  check_flat("equalize", input);
  Layout const layout = layout_of(input);
  Tensor const x = dense_planes(input, layout), y = empty_like(x, layout), changed = empty({x.size(0), x.size(1)}, x);
#if defined(KV_CUDA)
  Tensor const memory = empty({x.size(0) * x.size(1), kLevels}, x, Layout::planar, ScalarType::Int);
  auto* const counts = static_cast<int32_t*>(memory.mutable_data_ptr());
#else
  int32_t* const counts = nullptr;
#endif
  for_floats("equalize", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Equalize<T> const params{flat_planes<T const>(x, layout), flat_planes<T>(y, layout),
                             static_cast<T*>(changed.mutable_data_ptr()), opencv, counts};
    KV_RUN(equalize, x, params, params.x.count(), 2 * params.x.width);
  });
  return {y, changed};
}

}  // namespace

KV_OPERATOR(equalize, "(Tensor input, bool opencv) -> (Tensor output, Tensor changed)")

}  // namespace kv
