// filter2d_separable: schemas and entries, for CPU and CUDA.
#include "separable_glue.h"

namespace kv::filters {
namespace {

// Of SeparableWeightsBackward: a tile of the CUDA kernel is as wide as its blocks, one of the CPU kernel as the image.
#if defined(KV_CUDA)
int64_t tile_width(int64_t) { return kWeightsTileWidth; }
#else
int64_t tile_width(int64_t width) { return width; }
#endif

Tensor run(char const* op, Tensor const& input, Tensor const& kernel_x, Tensor const& kernel_y, int64_t border,
           bool same, bool transposed) {
  Tensor const kx = checked_weights(op, kernel_x, input), ky = checked_weights(op, kernel_y, input);
  return run_separable(op, input, {&kx, kx.size(1)}, {&ky, ky.size(1)}, to_border(op, border), same, transposed);
}

Tensor filter2d_separable(Tensor const& input, Tensor const& kernel_x, Tensor const& kernel_y, int64_t border,
                          bool same) {
  return run("filter2d_separable", input, kernel_x, kernel_y, border, same, false);
}

Tensor filter2d_separable_backward(Tensor const& grad, Tensor const& kernel_x, Tensor const& kernel_y, int64_t border,
                                   bool same) {
  return run("filter2d_separable_backward", grad, kernel_x, kernel_y, border, same, true);
}

// (B, kW + kH): for each sample its gradient to kernel_x, then that to kernel_y.
Tensor filter2d_separable_weights_backward(Tensor const& kernel_x, Tensor const& kernel_y, Tensor const& grad,
                                           Tensor const& input, int64_t border_mode, bool same) {
  char const* const op = "filter2d_separable_weights_backward";
  check_images(op, "input", input);
  check_images(op, "grad", grad);
  Tensor const row_x = checked_weights(op, kernel_x, input), row_y = checked_weights(op, kernel_y, input);
  int64_t const taps_x = row_x.size(1), taps_y = row_y.size(1);
  KV_CHECK(grad.scalar_type() == input.scalar_type() && grad.device() == input.device() &&
               grad.size(0) == input.size(0) && grad.size(1) == input.size(1) &&
               grad.size(2) == input.size(2) - (same ? 0 : taps_y - 1) &&
               grad.size(3) == input.size(3) - (same ? 0 : taps_x - 1),
           op, ": grad does not fit input");
  Border const named = to_border(op, border_mode), border = same ? named : Border::constant;
  if (same) {
    check_border(op, border, taps_y / 2, input.size(2));
    check_border(op, border, taps_x / 2, input.size(3));
  }
  Layout const layout = Layout::planar;
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout);
  Tensor sums;
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SeparableWeightsBackward<T> params{planes<T const>(g, layout),
                                       planes<T const>(x, layout),
                                       AxisWeights{&row_x, taps_x}.template taps<F>(same, false),
                                       AxisWeights{&row_y, taps_y}.template taps<F>(same, false),
                                       x.size(1),
                                       border,
                                       64,
                                       1,
                                       nullptr};
    params.tile_width = tile_width(params.grad.width);
    sums = empty({x.size(0), params.tiles(), taps_x + taps_y}, row_x);
    params.sums = static_cast<F*>(sums.mutable_data_ptr());
    KV_RUN(separable_weights_backward, x, params, x.size(0) * params.tiles(),
           params.grad.width * 16 * (taps_x + taps_y));
  });
  int64_t const tiles[] = {1};
  return torch::stable::sum(sums, tiles);
}

}  // namespace

KV_OPERATOR(filter2d_separable, "(Tensor input, Tensor kernel_x, Tensor kernel_y, int border, bool same) -> Tensor")
KV_OPERATOR(filter2d_separable_backward,
            "(Tensor grad, Tensor kernel_x, Tensor kernel_y, int border, bool same) -> Tensor")
KV_OPERATOR(filter2d_separable_weights_backward,
            "(Tensor kernel_x, Tensor kernel_y, Tensor grad, Tensor input, int border, bool same) -> Tensor")

}  // namespace kv::filters
