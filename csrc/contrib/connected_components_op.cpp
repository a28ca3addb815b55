// Connected components: schema and entry, for CPU and CUDA.
#include "connected_components.h"
#include "glue/glue.h"

namespace kv::contrib {
namespace {

Tensor connected_components(Tensor const& input) {
  constexpr char const* op = "connected_components";
  check_images(op, "input", input);
  KV_CHECK(input.size(2) <= INT32_MAX / input.size(3), op, ": expected fewer than 2^31 pixels a plane");
  Tensor const x = as_layout(input, Layout::planar);
  Tensor const labels = empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x, Layout::planar, ScalarType::Long);
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    ConnectedComponents<T> const params{planes<T const>(x, Layout::planar),
                                        static_cast<int64_t*>(labels.mutable_data_ptr())};
    KV_RUN(connected_components, x, params, params.x.count(), 8 * params.x.height * params.x.width);
  });
  return labels;
}

}  // namespace

KV_OPERATOR(connected_components, "(Tensor input) -> Tensor")

}  // namespace kv::contrib
