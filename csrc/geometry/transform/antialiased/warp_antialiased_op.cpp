// Antialiased warps by a matrix and by maps: schemas and entries, for CPU and CUDA.
#include "geometry/transform/antialiased/warp_antialiased.h"
#include "geometry/transform/remap_glue.h"
#include "geometry/transform/warp_glue.h"

namespace kv::geometry {
namespace {

SamplingOptions antialiased_options(char const* op, int64_t padding, bool align_corners, Tensor const& x,
                                    std::optional<Tensor> const& fill, SampledImages const& sampled) {
  return {op, Interpolation::bilinear, parse_padding(op, padding), align_corners, x, fill, sampled};
}

// Samples of `image` at coordinates(type).
template <class Coords>
Tensor sampled_antialiased(Tensor const& image, SamplingOptions const& a, Size source, Size output, Coords coords) {
  int64_t const samples = a.images.samples, channels = image.size(1);
  Tensor const y = empty({samples, channels, output.height, output.width}, image, layout_of(image));
  dispatch_floating_and_uint8(a.op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    Sample<T> const params{a.of<T>(source, coords(Type<Compute<T>>{})),
                           images<T const>(image, a.images.images),
                           images<T>(y, samples),
                           {}};
    check_planes(a.op, params.x);
    check_planes(a.op, params.y);
    KV_RUN(sample_antialiased, image, params, y.numel() > 0 ? samples * output.height : 0,
           kAntialiasedCost * channels * output.width);
  });
  return y;
}

template <class Coords>
Tensor antialiased_image_gradient(Tensor const& grad, BatchSize const& batch, SamplingOptions const& a, Coords coords) {
  int64_t const channels = grad.size(1);
  return image_gradient(
      a.op, grad, batch, false, [&](auto type, Tensor const& from, Tensor const& to, Tensor const& sums) {
        using T = typename decltype(type)::type;
        SampleImageBackward<T> const params{a.of<T>(batch.size, coords(Type<Compute<T>>{})),
                                            images<T const>(from, a.images.samples), images<T>(to, batch.images),
                                            data_ptr<Compute<T>>(sums)};
        check_planes(a.op, params.grad);
        check_planes(a.op, params.grad_x);
        [[maybe_unused]] int64_t const cost =
            kAntialiasedCost * grad.size(2) * grad.size(3) * a.images.samples / std::max<int64_t>(batch.images, 1);
        KV_RUN(sample_antialiased_image_backward, from, params, batch.images * channels, cost);
      });
}

// --- by a matrix -----------------------------------------------------------------------------------------------------

Tensor warp_antialiased(Tensor const& image, Tensor const& matrix, std::optional<Tensor> const& fill,
                        std::optional<Tensor> const& image_index, std::vector<int64_t> size, int64_t padding,
                        bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_antialiased";
  check_images(op, "image", image);
  Size const output = checked_size(op, size), source = checked_size(op, image);
  SampledImages const sampled(op, image_index, image.size(0), rows_of(matrix), image);
  SamplingOptions const a = antialiased_options(op, padding, align_corners, image, fill, sampled);
  Matrix const m(op, matrix, image, sampled.samples, inverse, normalized, align_corners, source, output);
  return sampled_antialiased(image, a, source, output, [&]<class F>(Type<F>) { return m.coords<F>(); });
}

// The gradient to images of `size`, which is their number, height and width.
Tensor warp_antialiased_image_backward(Tensor const& grad, Tensor const& matrix,
                                       std::optional<Tensor> const& image_index, std::vector<int64_t> size,
                                       int64_t padding, bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_antialiased_image_backward";
  check_images(op, "grad", grad);
  BatchSize const batch = checked_batch_size(op, size);
  SampledImages const sampled(op, image_index, batch.images, grad.size(0), grad);
  KV_CHECK(grad.size(0) == sampled.samples, op, ": grad does not fit the images");
  SamplingOptions const a = antialiased_options(op, padding, align_corners, grad, {}, sampled);
  Matrix const m(op, matrix, grad, sampled.samples, inverse, normalized, align_corners, batch.size,
                 checked_size(op, grad));
  return antialiased_image_gradient(grad, batch, a, [&]<class F>(Type<F>) { return m.coords<F>(); });
}

Tensor warp_antialiased_matrix_backward(Tensor const& grad_output, Tensor const& image, Tensor const& matrix,
                                        std::optional<Tensor> const& fill, std::optional<Tensor> const& image_index,
                                        int64_t padding, bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_antialiased_matrix_backward";
  check_images(op, "image", image);
  check_images(op, "grad", grad_output);
  Size const source = checked_size(op, image), output = checked_size(op, grad_output);
  SampledImages const sampled(op, image_index, image.size(0), rows_of(matrix), image);
  int64_t const batch = sampled.samples;
  check_gradient(op, grad_output, image, batch);
  SamplingOptions const a = antialiased_options(op, padding, align_corners, image, fill, sampled);
  Matrix const m(op, matrix, image, batch, inverse, normalized, align_corners, source, output);
  Tensor const grad = with_rows(grad_output);
  int64_t const parts = coords_backward_parts(output, 1);
  Tensor const sums = empty({batch, parts, 9}, grad, Layout::planar, ScalarType::Double);
  Tensor const grad_matrix = empty({batch, m.use.rows, 3}, m.tensor);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SampleCoords<F> const coords = m.coords<F>();
    AntialiasedCoordsBackward<T> const params{{a.of<T>(source, coords),
                                               images<T const>(image, image.size(0)),
                                               images<T const>(grad, batch),
                                               {},
                                               {},
                                               data_ptr<double>(sums),
                                               parts},
                                              {}};
    check_planes(op, params.x);
    check_planes(op, params.grad);
    KV_RUN(sample_antialiased_coords_backward, image, params, batch * output.height,
           kAntialiasedCost * image.size(1) * output.width);
    WarpMatrixBackward<F> const gradient{coords, data_ptr<double const>(sums), parts, batch, data_ptr<F>(grad_matrix)};
    KV_RUN(warp_matrix_backward, image, gradient, batch, 9 * parts);
  });
  return grad_matrix;
}

// --- by maps ---------------------------------------------------------------------------------------------------------

int64_t rows_of_maps(Tensor const& x, Tensor const& y) { return rows_of(x) == 1 ? rows_of(y) : rows_of(x); }

Tensor remap_antialiased(Tensor const& image, Tensor const& map_x, Tensor const& map_y,
                         std::optional<Tensor> const& fill, std::optional<Tensor> const& image_index, int64_t padding,
                         bool align_corners, bool normalized, bool moves) {
  char const* const op = "remap_antialiased";
  check_images(op, "image", image);
  Size const source = checked_size(op, image);
  SampledImages const sampled(op, image_index, image.size(0), rows_of_maps(map_x, map_y), image);
  SamplingOptions const a = antialiased_options(op, padding, align_corners, image, fill, sampled);
  Map const map(op, map_x, map_y, image, sampled.samples, normalized, moves, align_corners);
  return sampled_antialiased(image, a, source, map.size(),
                             [&]<class F>(Type<F>) { return map.coords<F>(source, sampled.samples); });
}

Tensor remap_antialiased_image_backward(Tensor const& grad, Tensor const& map_x, Tensor const& map_y,
                                        std::optional<Tensor> const& image_index, std::vector<int64_t> size,
                                        int64_t padding, bool align_corners, bool normalized, bool moves) {
  char const* const op = "remap_antialiased_image_backward";
  check_images(op, "grad", grad);
  BatchSize const batch = checked_batch_size(op, size);
  SampledImages const sampled(op, image_index, batch.images, grad.size(0), grad);
  KV_CHECK(grad.size(0) == sampled.samples, op, ": grad does not fit the images");
  SamplingOptions const a = antialiased_options(op, padding, align_corners, grad, {}, sampled);
  Map const map(op, map_x, map_y, grad, sampled.samples, normalized, moves, align_corners);
  KV_CHECK(grad.size(2) == map.size().height && grad.size(3) == map.size().width, op, ": grad does not fit the map");
  return antialiased_image_gradient(grad, batch, a,
                                    [&]<class F>(Type<F>) { return map.coords<F>(batch.size, sampled.samples); });
}

// Gradients per sample, also where one map serves all.
std::tuple<Tensor, Tensor> remap_antialiased_map_backward(Tensor const& grad_output, Tensor const& image,
                                                          Tensor const& map_x, Tensor const& map_y,
                                                          std::optional<Tensor> const& fill,
                                                          std::optional<Tensor> const& image_index, int64_t padding,
                                                          bool align_corners, bool normalized, bool moves) {
  char const* const op = "remap_antialiased_map_backward";
  check_images(op, "image", image);
  check_images(op, "grad", grad_output);
  Size const source = checked_size(op, image), output = checked_size(op, grad_output);
  SampledImages const sampled(op, image_index, image.size(0), rows_of_maps(map_x, map_y), image);
  int64_t const batch = sampled.samples;
  SamplingOptions const a = antialiased_options(op, padding, align_corners, image, fill, sampled);
  Map const map(op, map_x, map_y, image, batch, normalized, moves, align_corners);
  check_gradient(op, grad_output, image, batch);
  KV_CHECK(output.height == map.size().height && output.width == map.size().width, op, ": grad does not fit the map");
  Tensor const grad = with_rows(grad_output);
  Tensor const grad_x = empty({batch, output.height, output.width}, map.x),
               grad_y = empty({batch, output.height, output.width}, map.x),
               grad_jacobian = empty({batch, 4, output.height, output.width}, map.x);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    AntialiasedCoordsBackward<T> const params{
        {a.of<T>(source, map.coords<F>(source, batch)), images<T const>(image, image.size(0)),
         images<T const>(grad, batch), Map::plane<F>(grad_x, batch), Map::plane<F>(grad_y, batch), nullptr, 0},
        images<F>(grad_jacobian, batch)};
    check_planes(op, params.x);
    check_planes(op, params.grad);
    KV_RUN(sample_antialiased_coords_backward, image, params, batch * output.height,
           kAntialiasedCost * image.size(1) * output.width);
    MapDifferencesBackward<F> const differences{images<F const>(grad_jacobian, batch), params.grad_x, params.grad_y};
    KV_RUN(map_differences_backward, image, differences, batch * output.height, 8 * output.width);
  });
  return {grad_x, grad_y};
}

}  // namespace

#define KV_ANTIALIASED_WARP_OPTIONS "int padding, bool align_corners, bool inverse, bool normalized"
#define KV_ANTIALIASED_REMAP_OPTIONS "int padding, bool align_corners, bool normalized, bool moves"

// Their arguments are those of `warp` and `remap`, without an interpolation.
KV_OPERATOR(
    warp_antialiased,
    "(Tensor image, Tensor matrix, Tensor? fill, Tensor? image_index, SymInt[] size, " KV_ANTIALIASED_WARP_OPTIONS
    ") -> Tensor")
KV_OPERATOR(warp_antialiased_image_backward,
            "(Tensor grad, Tensor matrix, Tensor? image_index, SymInt[] size, " KV_ANTIALIASED_WARP_OPTIONS
            ") -> Tensor")
KV_OPERATOR(warp_antialiased_matrix_backward,
            "(Tensor grad, Tensor image, Tensor matrix, Tensor? fill, Tensor? image_index, " KV_ANTIALIASED_WARP_OPTIONS
            ") -> Tensor")
KV_OPERATOR(
    remap_antialiased,
    "(Tensor image, Tensor map_x, Tensor map_y, Tensor? fill, Tensor? image_index, " KV_ANTIALIASED_REMAP_OPTIONS
    ") -> Tensor")
KV_OPERATOR(
    remap_antialiased_image_backward,
    "(Tensor grad, Tensor map_x, Tensor map_y, Tensor? image_index, SymInt[] size, " KV_ANTIALIASED_REMAP_OPTIONS
    ") -> Tensor")
KV_OPERATOR(remap_antialiased_map_backward,
            "(Tensor grad, Tensor image, Tensor map_x, Tensor map_y, Tensor? fill, Tensor? "
            "image_index, " KV_ANTIALIASED_REMAP_OPTIONS ") -> (Tensor, Tensor)")

#undef KV_ANTIALIASED_WARP_OPTIONS
#undef KV_ANTIALIASED_REMAP_OPTIONS

}  // namespace kv::geometry
