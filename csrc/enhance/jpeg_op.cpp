// The JPEG approximation: schemas and entries, for CPU and CUDA.
#include "glue/images.h"
#include "jpeg_glue.h"

namespace kv::enhance {
namespace {

void check_jpeg(char const* op, Tensor const& x) {
  check_images(op, "input", x);
  KV_CHECK(x.size(1) == 3, op, ": expected input of 3 channels, got ", x.size(1));
  KV_CHECK(x.size(2) <= (1 << 24) && x.size(3) <= (1 << 24) && x.size(0) <= INT32_MAX, op, ": input is too large");
}

int64_t padded(int64_t n) { return ceil_div(n, kJpegSide) * kJpegSide; }

Tensor jpeg_memory(Tensor const& x) {
  return empty({x.size(0), padded(x.size(2)) * padded(x.size(3)) / 2 * 3}, x, Layout::planar, compute_dtype(x));
}
template <class F>
JpegLevels<F> levels_of(Tensor const& memory, Tensor const& x) {
  return {data_ptr<F>(memory), padded(x.size(2)), padded(x.size(3))};
}

Tensor jpeg(Tensor const& input, OptionalTensor const& quality, OptionalTensor const& table_y,
            OptionalTensor const& table_c, double number) {
  constexpr char const* op = "jpeg";
  check_jpeg(op, input);
  JpegNumbers const numbers(op, input, quality, table_y, table_c, number);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout), memory = jpeg_memory(x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const levels = levels_of<F>(memory, x);
    int64_t const b = x.size(0);
    JpegBlocks<T> const blocks{images<T const>(x, b), levels, numbers.tables<F>()};
    KV_RUN(jpeg_blocks, x, blocks, b * (levels.height / kJpegSide), 16 * kJpegSide * levels.width);
    JpegPixels<T> const pixels{levels, images<T>(y, b)};
    KV_RUN(jpeg_pixels, x, pixels, b * x.size(2), 4 * levels.width);
  });
  return y;
}

// The gradients of the image, and of every image's quality (B, 1) and tables (B, 8, 8). A gradient that is not needed
// has no elements.
std::tuple<Tensor, Tensor, Tensor, Tensor> jpeg_backward(Tensor const& grad, Tensor const& input,
                                                         OptionalTensor const& quality, OptionalTensor const& table_y,
                                                         OptionalTensor const& table_c, double number, bool of_image,
                                                         bool of_steps) {
  constexpr char const* op = "jpeg_backward";
  check_jpeg(op, input);
  check_like(op, "grad", grad, input);
  JpegNumbers const numbers(op, input, quality, table_y, table_c, number);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), g = as_layout(grad, layout), memory = jpeg_memory(x);
  ScalarType const computes = compute_dtype(x);
  int64_t const b = x.size(0), of = of_steps ? 1 : 0;
  Tensor const grad_x = of_image ? empty_like(x, layout) : empty({b, 0}, x);
  auto const make = [&](torch::headeronly::IntHeaderOnlyArrayRef sizes) {
    return empty(sizes, x, Layout::planar, computes);
  };
  Tensor const grad_quality = make({b, of}), grad_y = make({b, 8 * of, 8}), grad_c = make({b, 8 * of, 8});
  Tensor const grad_memory = of_image ? jpeg_memory(x) : make({0});
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const levels = levels_of<F>(memory, x), grad_levels = levels_of<F>(grad_memory, x);
    int64_t const units = b * (levels.height / kJpegSide);
    [[maybe_unused]] int64_t const cost = 16 * kJpegSide * levels.width;  // per CPU task
#if defined(KV_CUDA)
    int64_t const chunks = (levels.height / kJpegSide) * ceil_div(levels.width, kJpegWidth);
#else
    int64_t const chunks = levels.height / kJpegSide;
#endif
    Tensor const gradients = make({of * b * chunks, 128});
    JpegBlocks<T> const blocks{images<T const>(x, b), levels, numbers.tables<F>()};
    KV_RUN(jpeg_blocks, x, blocks, units, cost);
    JpegBlocksBackward<T> const backward{blocks, images<T const>(g, b), grad_levels,
                                         of_steps ? data_ptr<F>(gradients) : nullptr, chunks};
    KV_RUN(jpeg_blocks_backward, x, backward, units, 2 * cost);
    if (of_image) {
      JpegPixelsBackward<T> const pixels{grad_levels, images<T>(grad_x, b)};
      KV_RUN(jpeg_pixels_backward, x, pixels, b * x.size(2), 4 * levels.width);
    }
    if (of_steps) {
      JpegStepsBackward<F> const steps{
          blocks.tables,       data_ptr<F>(gradients), b, chunks, data_ptr<F>(grad_quality),
          data_ptr<F>(grad_y), data_ptr<F>(grad_c)};
      KV_RUN(jpeg_steps_backward, x, steps, b, 128 * chunks);
    }
  });
  return {grad_x, grad_quality, grad_y, grad_c};
}

}  // namespace

KV_OPERATOR(jpeg, "(Tensor input, Tensor? quality, Tensor? table_y, Tensor? table_c, float number) -> Tensor")
KV_OPERATOR(jpeg_backward,
            "(Tensor grad, Tensor input, Tensor? quality, Tensor? table_y, Tensor? table_c, float number,"
            " bool of_image, bool of_steps) -> (Tensor, Tensor, Tensor, Tensor)")

}  // namespace kv::enhance
