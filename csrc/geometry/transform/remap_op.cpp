// Sampling at the coordinates of a map: schemas and entries, for CPU and CUDA.
#include "geometry/transform/remap_glue.h"

namespace kv::geometry {
namespace {

Tensor remap(Tensor const& image, Tensor const& map_x, Tensor const& map_y, std::optional<Tensor> const& fill,
             std::optional<Tensor> const& image_index, int64_t interpolation, int64_t padding, bool align_corners,
             bool normalized, bool moves) {
  check_images("remap", "image", image);
  Size const source = checked_size("remap", image);
  SampledImages const sampled("remap", image_index, image.size(0),
                              rows_of(map_x) == 1 ? rows_of(map_y) : rows_of(map_x), image);
  int64_t const batch = sampled.samples;
  SamplingOptions const a("remap", interpolation, padding, align_corners, image, fill, sampled);
  Map const map("remap", map_x, map_y, image, batch, normalized, moves, align_corners);
  int64_t const channels = image.size(1), height = map.size().height, width = map.size().width;
  Tensor const y = empty({batch, channels, height, width}, image, layout_of(image));
  dispatch_floating_and_uint8("remap", image, [&](auto type) {
    using T = typename decltype(type)::type;
    Sample<T> const params{a.of<T>(source, map.coords<Compute<T>>(source, batch)),
                           images<T const>(image, image.size(0)), images<T>(y, batch)};
    check_planes("remap", params.x);
    check_planes("remap", params.y);
    KV_RUN(sample, image, params, y.numel() > 0 ? batch * height : 0, 4 * channels * width);
  });
  return y;
}

// The gradient to images of `size`, which is their number, height and width.
Tensor remap_image_backward(Tensor const& grad, Tensor const& map_x, Tensor const& map_y,
                            std::optional<Tensor> const& image_index, std::vector<int64_t> size, int64_t interpolation,
                            int64_t padding, bool align_corners, bool normalized, bool moves) {
  char const* const op = "remap_image_backward";
  check_images(op, "grad", grad);
  BatchSize const batch = checked_batch_size(op, size);
  Size const source = batch.size;
  SampledImages const sampled(op, image_index, batch.images, grad.size(0), grad);
  KV_CHECK(grad.size(0) == sampled.samples, op, ": grad does not fit the images");
  SamplingOptions const a(op, interpolation, padding, align_corners, grad, {}, sampled);
  Map const map(op, map_x, map_y, grad, sampled.samples, normalized, moves, align_corners);
  KV_CHECK(grad.size(2) == map.size().height && grad.size(3) == map.size().width, op, ": grad does not fit the map");
  int64_t const channels = grad.size(1);
  return image_gradient(
      op, grad, batch, false, [&](auto type, Tensor const& from, Tensor const& to, Tensor const& sums) {
        using T = typename decltype(type)::type;
        SampleImageBackward<T> const params{a.of<T>(source, map.coords<Compute<T>>(source, sampled.samples)),
                                            images<T const>(from, sampled.samples), images<T>(to, batch.images),
                                            data_ptr<Compute<T>>(sums)};
        [[maybe_unused]] int64_t const cost =
            8 * grad.size(2) * grad.size(3) * sampled.samples / std::max<int64_t>(batch.images, 1);
        KV_RUN(sample_image_backward, from, params, batch.images * channels, cost);
      });
}

// Gradients per sample, also where one map serves all.
std::tuple<Tensor, Tensor> remap_map_backward(Tensor const& grad, Tensor const& image, Tensor const& map_x,
                                              Tensor const& map_y, std::optional<Tensor> const& fill,
                                              std::optional<Tensor> const& image_index, int64_t interpolation,
                                              int64_t padding, bool align_corners, bool normalized, bool moves) {
  char const* const op = "remap_map_backward";
  check_images(op, "image", image);
  check_images(op, "grad", grad);
  Size const source = checked_size(op, image);
  SampledImages const sampled(op, image_index, image.size(0), rows_of(map_x) == 1 ? rows_of(map_y) : rows_of(map_x),
                              image);
  int64_t const batch = sampled.samples;
  SamplingOptions const a(op, interpolation, padding, align_corners, image, fill, sampled);
  Map const map(op, map_x, map_y, image, batch, normalized, moves, align_corners);
  check_gradient(op, grad, image, batch);
  KV_CHECK(grad.size(2) == map.size().height && grad.size(3) == map.size().width, op, ": grad does not fit the map");
  Tensor const grad_x = empty({batch, grad.size(2), grad.size(3)}, map.x);
  Tensor const grad_y = empty({batch, grad.size(2), grad.size(3)}, map.x);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SampleCoordsBackward<T> const params{a.of<T>(source, map.coords<F>(source, batch)),
                                         images<T const>(image, image.size(0)),
                                         images<T const>(grad, batch),
                                         Map::plane<F>(grad_x, batch),
                                         Map::plane<F>(grad_y, batch),
                                         nullptr,
                                         0};
    check_planes(op, params.x);
    check_planes(op, params.grad);
    KV_RUN(sample_coords_backward, image, params, batch * grad.size(2), 8 * image.size(1) * grad.size(3));
  });
  return {grad_x, grad_y};
}

}  // namespace

#define KV_REMAP_OPTIONS "int interpolation, int padding, bool align_corners, bool normalized, bool moves"

KV_OPERATOR(remap, "(Tensor image, Tensor map_x, Tensor map_y, Tensor? fill, Tensor? image_index, " KV_REMAP_OPTIONS
                   ") -> Tensor")
KV_OPERATOR(remap_image_backward,
            "(Tensor grad, Tensor map_x, Tensor map_y, Tensor? image_index, SymInt[] size, " KV_REMAP_OPTIONS
            ") -> Tensor")
KV_OPERATOR(
    remap_map_backward,
    "(Tensor grad, Tensor image, Tensor map_x, Tensor map_y, Tensor? fill, Tensor? image_index, " KV_REMAP_OPTIONS
    ") -> (Tensor, Tensor)")

#undef KV_REMAP_OPTIONS

}  // namespace kv::geometry
