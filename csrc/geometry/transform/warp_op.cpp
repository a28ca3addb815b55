// Warps by a matrix: schemas and entry points of the operators, for CPU and CUDA.
#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {
namespace {

Tensor warped(Tensor const& image, SamplingOptions const& a, Matrix const& m) {
  Size const source = m.use.source, output = m.use.output;
  int64_t const batch = image.size(0), channels = image.size(1);
  Tensor const y = empty({batch, channels, output.height, output.width}, image, layout_of(image));
  dispatch_floating_and_uint8(a.op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    Sample<T> const params{a.of<T>(source, m.coords<Compute<T>>()), images<T const>(image, batch), images<T>(y, batch),
                           m.formula};
    check_planes(a.op, params.x);
    check_planes(a.op, params.y);
    KV_RUN(sample, image, params, y.numel() > 0 ? batch * output.height : 0, 4 * channels * output.width);
  });
  return y;
}

Tensor warp(Tensor const& image, Tensor const& matrix, std::optional<Tensor> const& fill, std::vector<int64_t> size,
            int64_t interpolation, int64_t padding, bool align_corners, bool inverse, bool normalized) {
  check_images("warp", "image", image);
  Size const output = checked_size("warp", size), source = checked_size("warp", image);
  SamplingOptions const a("warp", interpolation, padding, align_corners, image, fill);
  return warped(image, a, {"warp", matrix, image, inverse, normalized, align_corners, source, output});
}

Tensor warp_by_formula(Tensor const& x, std::optional<Tensor> const& a, std::optional<Tensor> const& b,
                       std::optional<Tensor> const& c, std::optional<Tensor> const& d, std::optional<Tensor> const& e,
                       std::optional<Tensor> const& f, int64_t formula, std::vector<double> numbers,
                       std::vector<int64_t> size, int64_t interpolation, int64_t padding, bool align_corners,
                       bool inverse, bool normalized) {
  char const* const op = "warp_by_formula";
  check_images(op, "image", x);
  Size const output = checked_size(op, size), source = checked_size(op, x);
  SamplingOptions const how(op, interpolation, padding, align_corners, x, {});
  FormulaInputs const inputs{a, b, c, d, e, f};
  auto const run = [&](WarpMatrix const& m) {
    return warped(x, how, {m, inverse, normalized, align_corners, source, output});
  };
  bool const within = is_computed_in_kernel(x.size(0), output);
  KV_PLANE_FORMULAS(KV_WARP_BY)
  KV_CHECK(false, op, ": no formula of images has the number ", formula);
  return x;
}

Tensor warp_image_backward(Tensor const& grad, Tensor const& matrix, std::vector<int64_t> size, int64_t interpolation,
                           int64_t padding, bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_image_backward";
  check_images(op, "grad", grad);
  Size const source = checked_size(op, size), output = checked_size(op, grad);
  SamplingOptions const a(op, interpolation, padding, align_corners, grad, {});
  Matrix const m(op, matrix, grad, inverse, normalized, align_corners, source, output);
  int64_t const batch = grad.size(0), channels = grad.size(1);
  return image_gradient(
      op, grad, source, a.padding == Padding::fill,
      [&](auto type, Tensor const& from, Tensor const& to, Tensor const& sums) {
        using T = typename decltype(type)::type;
        SampleImageBackward<T> const params{a.of<T>(source, m.coords<Compute<T>>()), images<T const>(from, batch),
                                            images<T>(to, batch), data_ptr<Compute<T>>(sums)};
        check_planes(op, params.grad);
        check_planes(op, params.grad_x);
        KV_RUN(sample_image_backward, from, params, batch * channels, 8 * output.height * output.width);
      });
}

Tensor warp_matrix_backward(Tensor const& grad, Tensor const& image, Tensor const& matrix,
                            std::optional<Tensor> const& fill, int64_t interpolation, int64_t padding,
                            bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_matrix_backward";
  check_images(op, "image", image);
  check_images(op, "grad", grad);
  Size const source = checked_size(op, image), output = checked_size(op, grad);
  check_gradient(op, grad, image);
  SamplingOptions const a(op, interpolation, padding, align_corners, image, fill);
  Matrix const m(op, matrix, image, inverse, normalized, align_corners, source, output);
  int64_t const batch = image.size(0);
  int64_t const parts = coords_backward_parts(output, tiles_per_block(batch, output.height, output.width));
  Tensor const sums = empty({batch, parts, 9}, grad, Layout::planar, ScalarType::Double);
  Tensor const grad_matrix = empty({batch, m.use.rows, 3}, m.tensor);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SampleCoords<F> const coords = m.coords<F>();
    SampleCoordsBackward<T> const params{a.of<T>(source, coords),
                                         images<T const>(image, batch),
                                         images<T const>(grad, batch),
                                         {},
                                         {},
                                         data_ptr<double>(sums),
                                         parts};
    check_planes(op, params.x);
    check_planes(op, params.grad);
    KV_RUN(sample_coords_backward, image, params, batch * output.height, 8 * image.size(1) * output.width);
    WarpMatrixBackward<F> const gradient{coords, data_ptr<double const>(sums), parts, batch, data_ptr<F>(grad_matrix)};
    KV_RUN(warp_matrix_backward, image, gradient, batch, 9 * parts);
  });
  return grad_matrix;
}

}  // namespace

KV_OPERATOR(warp, "(Tensor image, Tensor matrix, Tensor? fill, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp_by_formula, "(Tensor image, " KV_BY_FORMULA KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp_image_backward, "(Tensor grad, Tensor matrix, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp_matrix_backward,
            "(Tensor grad, Tensor image, Tensor matrix, Tensor? fill, " KV_WARP_OPTIONS ") -> Tensor")

}  // namespace kv::geometry
