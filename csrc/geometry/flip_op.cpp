// Flips: schema and entry, for CPU and CUDA alike.
#include "flip.h"
#include "glue/glue.h"

namespace kv {
namespace {

Tensor flip(Tensor const& input, bool columns, bool rows) {
  check_images("flip", "input", input);
  Layout const layout = layout_of(input);
  Tensor const x = conform(input, layout), y = empty_like(x, layout);
  for_floats_and_bytes("flip", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Flip<T> params{planes<T const>(x, layout), planes<T>(y, layout), columns, rows};
    if (!columns) {  // a row's elements stay in order, so that channels need no care
      params.x.width = params.y.width = x.numel() ? params.x.row_size() : 0;
      params.x.step = params.y.step = 1;
    }
    KV_RUN(flip, x, params, params.x.row_size() ? params.x.rows() : 0, params.x.row_size());
  });
  return y;
}

}  // namespace

KV_OPERATOR(flip, "(Tensor input, bool columns, bool rows) -> Tensor")

}  // namespace kv
