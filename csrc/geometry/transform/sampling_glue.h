// Shared by the operators that sample: names of options, argument checks, axes and fills.
#pragma once

#include "geometry/formula_glue.h"
#include "geometry/transform/resize/resize.h"
#include "geometry/transform/sampling.h"
#include "glue/batch.h"
#include "glue/images.h"

namespace kv::geometry {

// Interpolations have the numbers of the filters that resize images.
inline Interpolation parse_interpolation(char const* op, int64_t number) {
  if (number == int64_t(ResizeFilter::nearest)) return Interpolation::nearest;
  if (number == int64_t(ResizeFilter::bilinear)) return Interpolation::bilinear;
  KV_CHECK(number == int64_t(ResizeFilter::bicubic), op,
           ": interpolation must be 0 (nearest), 3 (bilinear) or 4 (bicubic), got ", number);
  return Interpolation::bicubic;
}

inline Padding parse_padding(char const* op, int64_t number) {
  KV_CHECK(number >= int64_t(Padding::fill) && number <= int64_t(Padding::reflection), op,
           ": padding must be 0 (fill), 1 (border) or 2 (reflection), got ", number);
  return Padding(number);
}

// Sides of images fit an int with what lies around them, and a float's whole numbers nearly so.
constexpr int64_t kLargestSide = 1 << 30;

inline Size checked_size(char const* op, std::vector<int64_t> const& size) {
  KV_CHECK(size.size() == 2, op, ": expected a size of height and width, got ", size.size(), " numbers");
  for (int64_t side : size)
    KV_CHECK(side > 0 && side <= kLargestSide, op, ": expected a size of 1 to ", kLargestSide, " pixels, got ", side);
  return {size[0], size[1]};
}

inline Size checked_size(char const* op, Tensor const& x) { return checked_size(op, {x.size(2), x.size(3)}); }

// Of a map that an operator makes.
inline Size map_size(char const* op, std::vector<int64_t> const& sides) {
  Size const size = checked_size(op, sides);
  KV_CHECK(size.height * size.width <= INT32_MAX, op, ": expected a map of less than 2^31 pixels");
  return size;
}

// Kernels on CUDA count the elements of a plane in ints.
template <class T>
void check_planes([[maybe_unused]] char const* op, [[maybe_unused]] Images<T> const& x) {
#if defined(KV_CUDA)
  KV_CHECK(x.height * x.row_stride <= INT32_MAX, op, ": expected planes of less than 2^31 elements, got ", x.height,
           " rows of ", x.row_stride);
#endif
}

// The number of partial sums of the gradients of an output: one for a row of tiles on CUDA, one for each row of pixels
// on the CPU.
inline int64_t coords_backward_parts(Size output, [[maybe_unused]] int row) {
#if defined(KV_CUDA)
  return ceil_div(output.height, kTile) * ceil_div(output.width, row * kTile);
#else
  return output.height;
#endif
}

// Whether t can accompany samples of x: of the compute type, with one row for each sample or for all.
inline bool matches_samples(Tensor const& t, Tensor const& x, int64_t axes, int64_t samples) {
  return t.dim() == axes && t.scalar_type() == compute_dtype(x) && t.device() == x.device() &&
         (t.size(0) == 1 || t.size(0) == samples);
}
inline bool matches_image(Tensor const& t, Tensor const& x, int64_t axes) {
  return matches_samples(t, x, axes, x.size(0));
}

// The rows of a tensor that has not been checked yet.
inline int64_t rows_of(Tensor const& t) { return t.dim() ? t.size(0) : 1; }

// Which image each sample reads.
struct SampledImages {
  int64_t images, samples;
  std::optional<Tensor> index;  // dense, int64

  // With `image_index`, (N,) int64 or int32, N samples; else `rows` samples of one image, or one of each image.
  SampledImages(char const* op, std::optional<Tensor> const& image_index, int64_t images, int64_t rows,
                Tensor const& like)
      : images(images), samples(images == 1 ? rows : images) {
    if (!image_index) return;
    ScalarType const type = image_index->scalar_type();
    KV_CHECK(image_index->dim() == 1 && (type == ScalarType::Long || type == ScalarType::Int) &&
                 image_index->device() == like.device(),
             op, ": expected image_index of shape (N,), int64 or int32, on the device of the images");
    samples = image_index->size(0);
    KV_CHECK(images > 0 || samples == 0, op, ": expected images for the samples of image_index");
    index = type == ScalarType::Long ? dense(*image_index) : empty({samples}, like, Layout::planar, ScalarType::Long);
    if (type != ScalarType::Long) torch::stable::copy_(*index, *image_index);
#if !defined(KV_CUDA)
    auto const* const at = data_ptr<int64_t const>(*index);
    for (int64_t b = 0; b < samples; ++b)
      KV_CHECK(at[b] >= 0 && at[b] < images, op, ": expected image_index from 0 to ", images - 1, ", got ", at[b]);
#endif
  }
  bool is_one_sample_per_image() const { return !index && images == samples; }
};

// The size of a batch of images: their number, height and width.
struct BatchSize {
  int64_t images;
  Size size;
};
inline BatchSize checked_batch_size(char const* op, std::vector<int64_t> const& size) {
  KV_CHECK(size.size() == 3 && size[0] >= 0, op, ": expected a size of images, height and width, got ", size.size(),
           " numbers");
  return {size[0], checked_size(op, {size[1], size[2]})};
}

template <class F>
void dispatch_compute_dtype(char const* op, Tensor const& x, F f) {
  if (x.scalar_type() == ScalarType::Float) return f(Type<float>{});
  KV_CHECK(x.scalar_type() == ScalarType::Double, op, ": expected float32 or float64");
  f(Type<double>{});
}

// Raises unless `grad` may be the gradient of `samples` samples of x.
inline void check_gradient(char const* op, Tensor const& grad, Tensor const& x, int64_t samples) {
  KV_CHECK(grad.size(0) == samples && grad.size(1) == x.size(1) && grad.scalar_type() == x.scalar_type() &&
               grad.device() == x.device(),
           op, ": grad does not fit what it is the gradient of");
}

// The gradient to images of that size, by run(type, grad, grad_x, sums). Kernels that write every pixel once have its
// sum in registers; others add to memory, in the type that computes.
template <class Run>
Tensor image_gradient(char const* op, Tensor const& grad, BatchSize const& batch, [[maybe_unused]] bool writes_once,
                      Run run) {
  std::vector<int64_t> const sizes{batch.images, grad.size(1), batch.size.height, batch.size.width};
  bool const half = grad.scalar_type() == ScalarType::Half || grad.scalar_type() == ScalarType::BFloat16;
  Tensor grad_x = empty(sizes, grad);
#if defined(KV_CUDA)
  Tensor const sums = half && !writes_once ? empty(sizes, grad, Layout::planar, ScalarType::Float) : grad_x;
  dispatch_floating(op, grad, [&](auto type) { run(type, grad, grad_x, sums); });
  return half && !writes_once ? torch::stable::copy_(grad_x, sums) : grad_x;
#else
  if (!half) {
    dispatch_compute_dtype(op, grad, [&](auto type) { run(type, grad, grad_x, grad_x); });
    return grad_x;
  }
  Tensor promoted = empty(grad.sizes(), grad, layout_of(grad), ScalarType::Float);
  Tensor const sums = empty(sizes, grad, Layout::planar, ScalarType::Float);
  torch::stable::copy_(promoted, grad);
  dispatch_compute_dtype(op, promoted, [&](auto type) { run(type, promoted, sums, sums); });
  return torch::stable::copy_(grad_x, sums);
#endif
}

// The matrix of a warp: a tensor, or on CUDA the inputs of a formula by which the kernel computes it.
struct WarpMatrix {
  Tensor tensor;
  MatrixFormula formula{};
  int rows;
  int64_t stride;  // from a sample to the next, 0 where one serves all

  // For samples of images or volumes x, with this number of axes.
  WarpMatrix(char const* op, Tensor const& matrix, Tensor const& x, int axes, int64_t samples)
      : tensor(matrix), rows(int(matrix.dim() > 1 ? matrix.size(1) : 0)) {
    KV_CHECK(matches_samples(matrix, x, 3, samples) && (rows == axes || rows == axes + 1) && matrix.size(2) == axes + 1,
             op, ": matrix does not fit what is warped");
    tensor = dense(matrix);
    stride = matrix.size(0) == 1 ? 0 : rows * (axes + 1);
  }
  // By formula F, whose number is `id`: computed by the warp's own CUDA kernel if `within`, otherwise here.
  template <class F>
  WarpMatrix(char const* op, FormulaArguments<F>& arguments, [[maybe_unused]] WarpFormula id, Tensor const& x,
             int64_t samples, [[maybe_unused]] bool within)
      : rows(arguments.extent().rows), stride(arguments.params.batch == 1 ? 0 : rows * arguments.extent().columns) {
    KV_CHECK(arguments.params.batch == 1 || arguments.params.batch == samples, op, ": expected tensors with 1 or ",
             samples, " rows, got ", arguments.params.batch);
#if defined(KV_CUDA)
    if (within) {
      formula.id = id;
      formula.options = arguments.params.options;
      for (int i = 0; i < std::min(F::kInputs, MatrixFormula::kInputs); ++i) {
        formula.inputs[i] = arguments.params.inputs[i];
        formula.strides[i] = arguments.params.strides[i];
      }
      return;
    }
#endif
    tensor = arguments.result(op, x);
  }
  template <class F>
  F const* data() const {
    return formula.id == WarpFormula::none ? data_ptr<F const>(tensor) : nullptr;
  }
};

// Whether a CUDA kernel computes the matrices itself. Each of its blocks waits for its matrix; with many blocks that
// takes longer than a separate launch before them.
inline bool is_computed_in_kernel(int64_t samples, Size output) {
  // Special case, H200: 0.97 (crop_and_resize) to 1.16 (rotate 8) times as fast as a launch before.
  return samples * ceil_div(output.height, kTile) * ceil_div(output.width, kTile) <= 1024;
}

// A formula and its inputs in operator schemas, and the C++ arguments for them.
#define KV_FORMULA_INPUTS "Tensor? a, Tensor? b, Tensor? c, Tensor? d, Tensor? e, Tensor? f, "
#define KV_FORMULA_OPTIONS "int formula, float[] numbers, SymInt[] size, "
using FormulaInputs = std::optional<Tensor>[MatrixFormula::kInputs];

// A case of a chain of ifs over formulas: run(the matrix) where `formula` is that one, of the kernels' formulas as it
// is of the operators'. Matrices that may have fewer rows have one less than columns.
#define KV_WARP_BY(name, Formula, signature)                                                       \
  if (formula == int64_t(WarpFormula::name)) {                                                     \
    FormulaArguments<Formula> arguments(op, x, compute_dtype(x), inputs, numbers,                  \
                                        Formula::kOptionalLastRow ? Formula::result.rows - 1 : 0); \
    return run(WarpMatrix(op, arguments, WarpFormula::name, x, samples, within));                  \
  }

// The options of warps by a matrix in operator schemas.
#define KV_WARP_OPTIONS "int interpolation, int padding, bool align_corners, bool inverse, bool normalized"

// The matrix of a warp of images, and what it means.
struct Matrix : WarpMatrix {
  MatrixUse use;

  Matrix(WarpMatrix const& matrix, bool inverse, bool normalized, bool align_corners, Size source, Size output)
      : WarpMatrix(matrix), use{rows, inverse, normalized, align_corners, source, output} {}
  Matrix(char const* op, Tensor const& matrix, Tensor const& x, int64_t samples, bool inverse, bool normalized,
         bool align_corners, Size source, Size output)
      : Matrix(WarpMatrix(op, matrix, x, 2, samples), inverse, normalized, align_corners, source, output) {}
  template <class F>
  SampleCoords<F> coords() const {
    SampleCoords<F> p{};
    p.matrices = data<F>();
    p.matrix_stride = stride;
    p.use = use;
    return p;
  }
};

// About how many taps an antialiased pixel has: the matrices are not read here.
constexpr int64_t kAntialiasedCost = 32;

// How an image of `source` is read, and for which gradient; what is read of it is up to the caller.
struct SamplingOptions {
  char const* op;
  Interpolation interpolation;
  Padding padding;
  bool align_corners;
  std::optional<Tensor> fill;
  SampledImages images;

  SamplingOptions(char const* op, int64_t interpolation, int64_t padding, bool align_corners, Tensor const& x,
                  std::optional<Tensor> const& fill, SampledImages const& images)
      : SamplingOptions(op, parse_interpolation(op, interpolation), parse_padding(op, padding), align_corners, x, fill,
                        images) {}
  SamplingOptions(char const* op, Interpolation interpolation, Padding padding, bool align_corners, Tensor const& x,
                  std::optional<Tensor> const& fill, SampledImages const& images)
      : op(op),
        interpolation(interpolation),
        padding(padding),
        align_corners(align_corners),
        fill(fill),
        images(images) {
    if (!fill) return;
    KV_CHECK(matches_samples(*fill, x, 2, images.samples) && (fill->size(1) == 1 || fill->size(1) == x.size(1)), op,
             ": fill does not fit the image");
  }
  // One sample of each image.
  template <class Number, class Choice>
  SamplingOptions(char const* op, Number interpolation, Choice padding, bool align_corners, Tensor const& x,
                  std::optional<Tensor> const& fill)
      : SamplingOptions(op, interpolation, padding, align_corners, x, fill, {op, {}, x.size(0), x.size(0), x}) {}

  template <class T>
  Sampling<T> of(Size source, SampleCoords<Compute<T>> const& coords) const {
    using F = Compute<T>;
    return {interpolation,
            {int(source.width), padding, align_corners},
            {int(source.height), padding, align_corners},
            coords,
            fill ? data_ptr<F const>(*fill) : nullptr,
            fill && fill->size(0) > 1 ? fill->stride(0) : 0,
            fill && fill->size(1) > 1 ? fill->stride(1) : 0,
            images.index ? data_ptr<int64_t const>(*images.index) : nullptr,
            images.images};
  }
};

}  // namespace kv::geometry
