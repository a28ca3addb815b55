// Patches: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "patches.h"

namespace kv::contrib {
namespace {

// Of images (B, C, size[0], size[1]), with padding (top, bottom, left, right) around them.
PatchGrid make_grid(char const* op, int64_t channels, std::vector<int64_t> const& size,
                    std::vector<int64_t> const& window, std::vector<int64_t> const& step,
                    std::vector<int64_t> const& padding) {
  KV_CHECK(size.size() == 2 && window.size() == 2 && step.size() == 2 && padding.size() == 4, op,
           ": expected size, window and stride of two numbers and padding of four");
  for (int64_t n : window) KV_CHECK(n > 0, op, ": expected a window of at least 1 pixel an axis");
  for (int64_t n : size) KV_CHECK(n > 0 && n <= INT32_MAX / 4, op, ": expected images of 1 to 2^29 pixels an axis");
  for (int64_t n : step) KV_CHECK(n > 0 && n <= INT32_MAX / 4, op, ": expected a stride of at least 1");
  for (int64_t n : padding) KV_CHECK(n >= 0 && n <= INT32_MAX / 4, op, ": expected a padding of at least 0");
  int64_t const height = size[0] + padding[0] + padding[1], width = size[1] + padding[2] + padding[3];
  KV_CHECK(height >= window[0] && width >= window[1], op, ": the window is larger than the images");
  return {channels,
          int((height - window[0]) / step[0] + 1),
          int((width - window[1]) / step[1] + 1),
          int(window[0]),
          int(window[1]),
          int(step[0]),
          int(step[1]),
          int(padding[0]),
          int(padding[2])};
}

Tensor extract_patches(Tensor const& input, std::vector<int64_t> size, std::vector<int64_t> window,
                       std::vector<int64_t> stride, std::vector<int64_t> padding) {
  constexpr char const* op = "extract_patches";
  check_images(op, "input", input);
  PatchGrid const grid = make_grid(op, input.size(1), size, window, stride, padding);
  KV_CHECK(input.size(2) == size[0] && input.size(3) == size[1], op, ": expected input of that size");
  Tensor const x = as_layout(input, Layout::planar);
  Tensor const patches = empty({x.size(0), int64_t(grid.down) * grid.across, x.size(1), grid.height, grid.width}, x);
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    Extract<T> const params{planes<T const>(x, Layout::planar), static_cast<T*>(patches.mutable_data_ptr()), grid};
    KV_RUN(extract_patches, x, params, params.image.count() * grid.down * grid.across * grid.height, grid.width);
  });
  return patches;
}

Tensor combine_patches(Tensor const& patches, std::vector<int64_t> size, std::vector<int64_t> window,
                       std::vector<int64_t> stride, std::vector<int64_t> padding) {
  constexpr char const* op = "combine_patches";
  check_volumes(op, "patches", patches);
  PatchGrid const grid = make_grid(op, patches.size(2), size, window, stride, padding);
  KV_CHECK(patches.size(1) == int64_t(grid.down) * grid.across && patches.size(3) == grid.height &&
               patches.size(4) == grid.width,
           op, ": expected as many patches of that size as fit the images");
  Tensor const x = dense(patches);
  Tensor const image = empty({x.size(0), x.size(2), size[0], size[1]}, x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    Combine<T> const params{static_cast<T const*>(x.const_data_ptr()), planes<T>(image, Layout::planar), grid};
    KV_RUN(combine_patches, x, params, params.image.rows(), 2 * params.image.width);
  });
  return image;
}

}  // namespace

KV_OPERATOR(extract_patches, "(Tensor input, SymInt[] size, int[] window, int[] stride, SymInt[] padding) -> Tensor")
KV_OPERATOR(combine_patches, "(Tensor patches, SymInt[] size, int[] window, int[] stride, SymInt[] padding) -> Tensor")

}  // namespace kv::contrib
