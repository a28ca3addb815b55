// Demosaicing: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "raw.h"

namespace kv::color {
namespace {

void check_mosaic(char const* op, char const* name, Tensor const& x, int64_t channels) {
  check_images(op, name, x);
  KV_CHECK(x.size(1) == channels && x.size(2) % 2 == 0 && x.size(3) % 2 == 0, op, ": expected ", name, " of ", channels,
           " channels with even height and width");
}

// The position of red in a cell of the color filter array.
struct RedPosition {
  int row, column;
};
// Of the color filter arrays BG, GB, RG and GR, OpenCV's names.
constexpr RedPosition kRedPositions[] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
RedPosition red_position(char const* op, int64_t cfa) {
  KV_CHECK(cfa >= 0 && cfa < 4, op, ": cfa must be one of 0 (BG), 1 (GB), 2 (RG), 3 (GR); got ", cfa);
  return kRedPositions[cfa];
}

Tensor raw_to_rgb(Tensor const& input, int64_t cfa) {
  check_mosaic("raw_to_rgb", "input", input, 1);
  RedPosition const red = red_position("raw_to_rgb", cfa);
  Tensor const x = as_layout(input, Layout::planar), y = empty({x.size(0), 3, x.size(2), x.size(3)}, x);
  dispatch_floating_and_uint8("raw_to_rgb", x, [&](auto type) {
    using T = typename decltype(type)::type;
    RawToRgb<T> const params{planes<T const>(x, Layout::planar), planes<T>(y, Layout::planar), red.row, red.column};
    KV_RUN(raw_to_rgb, x, params, params.raw.rows(), 3 * params.raw.width);
  });
  return y;
}

Tensor raw_to_rgb_backward(Tensor const& grad, int64_t cfa) {
  check_mosaic("raw_to_rgb_backward", "grad", grad, 3);
  RedPosition const red = red_position("raw_to_rgb_backward", cfa);
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

KV_OPERATOR(raw_to_rgb, "(Tensor input, int cfa) -> Tensor")
KV_OPERATOR(raw_to_rgb_backward, "(Tensor grad, int cfa) -> Tensor")

}  // namespace kv::color
