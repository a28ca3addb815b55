// Flips and crops of images: schemas and entries, for CPU and CUDA.
#include "geometry/transform/flip.h"
#include "glue/glue.h"

namespace kv::geometry {
namespace {

Tensor run_flip(char const* op, Tensor const& input, int64_t height, int64_t width, bool columns, bool rows,
                int64_t top, int64_t left) {
  check_images(op, "input", input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty({x.size(0), x.size(1), height, width}, x, layout);
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    Flip<T> params{planes<T const>(x, layout), planes<T>(y, layout), columns, rows, top, left};
    if (!columns && x.numel()) {  // elements of a row keep their order, so channels may be interleaved
      params.left *= params.x.step;
      params.x.width = params.x.row_size(), params.y.width = params.y.row_size();
      params.x.step = params.y.step = 1;
    }
    KV_RUN(flip, x, params, params.y.row_size() ? params.y.rows() : 0, params.y.row_size());
  });
  return y;
}

Tensor flip(Tensor const& input, bool columns, bool rows) {
  check_images("flip", "input", input);
  return run_flip("flip", input, input.size(2), input.size(3), columns, rows, 0, 0);
}

// The crop of `size` that begins at pixel `corner`, which may be out of bounds.
Tensor crop(Tensor const& input, std::vector<int64_t> corner, std::vector<int64_t> size) {
  constexpr int64_t kLargest = 1 << 30;
  KV_CHECK(corner.size() == 2 && size.size() == 2, "crop: expected two numbers for corner and size");
  for (int i = 0; i < 2; ++i)
    KV_CHECK(size[i] > 0 && size[i] <= kLargest && corner[i] >= -kLargest && corner[i] <= kLargest,
             "crop: expected sides of 1 to ", kLargest, " pixels and a corner as near, got ", size[i], " and ",
             corner[i]);
  return run_flip("crop", input, size[0], size[1], false, false, corner[0], corner[1]);
}

}  // namespace

KV_OPERATOR(flip, "(Tensor input, bool columns, bool rows) -> Tensor")
KV_OPERATOR(crop, "(Tensor input, SymInt[] corner, SymInt[] size) -> Tensor")

}  // namespace kv::geometry
