// Demosaicing: schemas and entries, for CPU and CUDA alike.
#include "glue/glue.h"
#include "raw.h"

namespace kv {
namespace {

void check_mosaic(char const* op, char const* name, Tensor const& x, int64_t channels) {
  check_images(op, name, x);
  KV_CHECK(x.size(1) == channels && x.size(2) % 2 == 0 && x.size(3) % 2 == 0, op, ": expected ", name, " of ", channels,
           " channels with even height and width");
}

// Where the colour filter array has red, by the name that OpenCV gives it.
struct Red {
  int row, column;
};
Red red_of(char const* op, std::string const& cfa) {
  if (cfa == "BG") return {0, 0};
  if (cfa == "GB") return {0, 1};
  if (cfa == "RG") return {1, 1};
  KV_CHECK(cfa == "GR", op, ": cfa must be one of BG, GB, RG, GR; got '", cfa, "'");
  return {1, 0};
}

Tensor raw_to_rgb(Tensor const& input, std::string cfa) {
  check_mosaic("raw_to_rgb", "input", input, 1);
  Red const red = red_of("raw_to_rgb", cfa);
  Tensor const x = as_layout(input, Layout::planar), y = empty({x.size(0), 3, x.size(2), x.size(3)}, x);
  dispatch_floating_and_uint8("raw_to_rgb", x, [&](auto type) {
    using T = typename decltype(type)::type;
    RawToRgb<T> const params{planes<T const>(x, Layout::planar), planes<T>(y, Layout::planar), red.row, red.column};
    KV_RUN(raw_to_rgb, x, params, params.raw.rows(), 3 * params.raw.width);
  });
  return y;
}

Tensor raw_to_rgb_backward(Tensor const& grad, std::string cfa) {
  check_mosaic("raw_to_rgb_backward", "grad", grad, 3);
  Red const red = red_of("raw_to_rgb_backward", cfa);
  Tensor const g = as_layout(grad, Layout::planar), x = empty({g.size(0), 1, g.size(2), g.size(3)}, g);
  dispatch_floating("raw_to_rgb_backward", g, [&](auto type) {
    using T = typename decltype(type)::type;
    RawToRgbBackward<T> const params{
        {{}, {}, red.row, red.column}, planes<T const>(g, Layout::planar), planes<T>(x, Layout::planar)};
    KV_RUN(raw_to_rgb_backward, x, params, params.grad_raw.rows(), 3 * params.grad_raw.width);
  });
  return x;
}

}  // namespace

KV_OPERATOR(raw_to_rgb, "(Tensor input, str cfa) -> Tensor")
KV_OPERATOR(raw_to_rgb_backward, "(Tensor grad, str cfa) -> Tensor")

}  // namespace kv
