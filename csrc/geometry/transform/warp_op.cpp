// Warps by a matrix: schemas and entries, for CPU and CUDA.
#include "geometry/transform/flip.h"
#include "geometry/transform/warp_glue.h"

namespace kv::geometry {
namespace {

Tensor warp(Tensor const& image, Tensor const& matrix, std::optional<Tensor> const& fill,
            std::optional<Tensor> const& image_index, std::vector<int64_t> size, int64_t interpolation, int64_t padding,
            bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp";
  check_images(op, "image", image);
  Size const output = checked_size(op, size), source = checked_size(op, image);
  SampledImages const sampled(op, image_index, image.size(0), rows_of(matrix), image);
  SamplingOptions const a(op, interpolation, padding, align_corners, image, fill, sampled);
  return warped(image, a, {op, matrix, image, sampled.samples, inverse, normalized, align_corners, source, output});
}

#if defined(KV_CUDA)
// The crop of planar images whose first pixel lies at (top, left), if it lies between pixels.
std::optional<Tensor> cropped_between(char const* op, Tensor const& image, Size output, double top, double left) {
  if (image.scalar_type() == ScalarType::Double || layout_of(image) != Layout::planar || image.numel() == 0) return {};
  std::optional<Tensor> result;
  Tensor const x = dense(image);
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    if constexpr (sizeof(T) < 8) {
      auto const from = planes<T const>(x, Layout::planar);
      if (!cuda::is_crop_between(from, output.height, output.width, top, left)) return;
      result = empty({x.size(0), x.size(1), output.height, output.width}, x);
      cuda::CropBetween<T> const params{
          from, planes<T>(*result, Layout::planar), int(top), int(left), top != int(top), left != int(left)};
      KV_RUN(crop_between, x, params, params.y.rows(), 0);
    }
  });
  return result;
}
#endif

Tensor warp_by_formula(Tensor const& x, std::optional<Tensor> const& a, std::optional<Tensor> const& b,
                       std::optional<Tensor> const& c, std::optional<Tensor> const& d, std::optional<Tensor> const& e,
                       std::optional<Tensor> const& f, std::optional<Tensor> const& image_index, int64_t formula,
                       std::vector<double> numbers, std::vector<int64_t> size, int64_t interpolation, int64_t padding,
                       bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_by_formula";
  check_images(op, "image", x);
  Size const output = checked_size(op, size), source = checked_size(op, x);
  FormulaInputs const inputs{a, b, c, d, e, f};
  int64_t rows = 1;
  for (auto const& input : inputs)
    if (rows == 1 && input) rows = rows_of(*input);
  SampledImages const sampled(op, image_index, x.size(0), rows, x);
  SamplingOptions const options(op, interpolation, padding, align_corners, x, {}, sampled);
  int64_t const samples = sampled.samples;
#if defined(KV_CUDA)
  bool const moves_by_numbers = formula == int64_t(WarpFormula::translation_matrix2d) && !a && numbers.size() == 2;
  if (moves_by_numbers && options.interpolation == Interpolation::bilinear && !image_index && !inverse && !normalized)
    if (auto const cropped = cropped_between(op, x, output, numbers[1], numbers[0])) return *cropped;
#endif
  auto const run = [&](WarpMatrix const& m) {
    return warped(x, options, {m, inverse, normalized, align_corners, source, output});
  };
  bool const within = is_computed_in_kernel(samples, output);
  KV_PLANE_FORMULAS(KV_WARP_BY)
  KV_CHECK(false, op, ": no formula of images has the number ", formula);
  return x;
}

// The gradient to images of `size`, which is their number, height and width.
Tensor warp_image_backward(Tensor const& grad, Tensor const& matrix, std::optional<Tensor> const& image_index,
                           std::vector<int64_t> size, int64_t interpolation, int64_t padding, bool align_corners,
                           bool inverse, bool normalized) {
  char const* const op = "warp_image_backward";
  check_images(op, "grad", grad);
  BatchSize const batch = checked_batch_size(op, size);
  Size const source = batch.size, output = checked_size(op, grad);
  SampledImages const sampled(op, image_index, batch.images, grad.size(0), grad);
  KV_CHECK(grad.size(0) == sampled.samples, op, ": grad does not fit the images");
  SamplingOptions const a(op, interpolation, padding, align_corners, grad, {}, sampled);
  Matrix const m(op, matrix, grad, sampled.samples, inverse, normalized, align_corners, source, output);
  return warp_image_gradient(grad, batch, a, m);
}

Tensor warp_matrix_backward(Tensor const& grad, Tensor const& image, Tensor const& matrix,
                            std::optional<Tensor> const& fill, std::optional<Tensor> const& image_index,
                            int64_t interpolation, int64_t padding, bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_matrix_backward";
  check_images(op, "image", image);
  check_images(op, "grad", grad);
  Size const source = checked_size(op, image), output = checked_size(op, grad);
  SampledImages const sampled(op, image_index, image.size(0), rows_of(matrix), image);
  int64_t const batch = sampled.samples;
  check_gradient(op, grad, image, batch);
  SamplingOptions const a(op, interpolation, padding, align_corners, image, fill, sampled);
  Matrix const m(op, matrix, image, batch, inverse, normalized, align_corners, source, output);
  return warp_matrix_gradient(grad, image, a, m);
}

}  // namespace

// Samples may outnumber the images: `image_index` (N,), of int64 or int32, has the image that each of them reads.
// Without it one image serves all samples, or sample b reads image b.
KV_OPERATOR(warp, "(Tensor image, Tensor matrix, Tensor? fill, Tensor? image_index, SymInt[] size, " KV_WARP_OPTIONS
                  ") -> Tensor")
KV_OPERATOR(warp_by_formula, "(Tensor image, " KV_FORMULA_INPUTS
                             "Tensor? image_index, " KV_FORMULA_OPTIONS KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp_image_backward,
            "(Tensor grad, Tensor matrix, Tensor? image_index, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor")
KV_OPERATOR(warp_matrix_backward,
            "(Tensor grad, Tensor image, Tensor matrix, Tensor? fill, Tensor? image_index, " KV_WARP_OPTIONS
            ") -> Tensor")

}  // namespace kv::geometry
