// Warps with a program of color steps: schemas and entries, for CPU and CUDA. A warp without steps, or steps
// without a warp, run as such. Where no kernel joins both, they run one after the other.
#include "augmentation/broadcast_scalar.h"
#include "augmentation/lists/warp_and_color_list.h"
#include "augmentation/mixing/pieces_glue.h"
#include "augmentation/mixing/warp_pieces.h"
#include "augmentation/plan_reader.h"
#include "augmentation/warp_and_color.h"
#include "augmentation/warp_and_color_glue.h"
#include "augmentation/warp_rows_backward.h"
#include "color/lists/program_list_glue.h"
#include "color/program_glue.h"
#include "geometry/transform/lists/resize_windows_list_glue.h"
#include "geometry/transform/lists/warp_list_glue.h"
#include "geometry/transform/resize/resize_windows_glue.h"
#include "geometry/transform/warp_glue.h"

namespace kv::augmentation {
namespace {

using OptionalTensor = std::optional<Tensor>;
using Numbers = std::vector<double>;

// The schemas' `plan`, as make_plan in warp_and_color.py writes it: the options (see kPassOptions); the number of
// integers of the transforms, and these; the number of steps, and these; the number of columns of their parameters, and
// these; and the order of the steps. `numbers` are those of the transforms, then those of the steps.
struct WarpAndColorPlan {
  int64_t interpolation, padding;
  bool align_corners, antialias;  // the latter of matrices that keep rows: windows are resized instead of warped
  std::span<int64_t const> transforms, order;
  color::PlanArgument program;
  std::span<double const> transform_numbers;
  Numbers numbers;

  WarpAndColorPlan(char const* op, std::vector<int64_t> const& plan, Numbers const& all_numbers) {
    PlanReader rest(op, plan, all_numbers);
    auto const head = rest.next(kPassOptions);
    KV_CHECK(head[0] >= -1 && head[0] <= int64_t(DType::float64), op, ": there is no dtype ", head[0]);
    KV_CHECK(head[1] >= -1 && head[1] <= 1, op, ": there is no layout ", head[1]);
    interpolation = head[2];
    padding = head[3];
    align_corners = head[4] != 0;
    antialias = head[5] != 0;
    auto const chain = rest.next_chain();
    transforms = chain.plan, transform_numbers = chain.numbers;
    auto const steps = rest.next_list();
    KV_CHECK(steps.size() <= color::kMaxSteps, op, ": expected at most ", color::kMaxSteps, " steps, got ",
             steps.size());
    program = {head[0], head[1], steps, rest.next_list()};
    order = rest.plan();
    numbers.assign(rest.numbers().begin(), rest.numbers().end());
  }
  bool has_steps() const { return !program.steps.empty(); }
};

// What the entries share: the checked arguments, and how images are read.
struct WarpAndColorArguments {
  char const* op;
  WarpAndColorPlan plan;
  Tensor columns;
  std::optional<geometry::Matrix> matrix;  // none: pixels keep their positions
  std::optional<geometry::SamplingOptions> sampling;
  OptionalTensor matrix_tensor;

  // With the matrices of an earlier call, or with none.
  WarpAndColorArguments(char const* op, Tensor const& image, OptionalTensor const& optional_columns,
                        OptionalTensor const& fill, OptionalTensor const& matrices, std::vector<int64_t> const& size,
                        std::vector<int64_t> const& plan_numbers, Numbers const& numbers)
      : op(op), plan(op, plan_numbers, numbers), columns(columns_of(op, image, optional_columns)) {
    if (size.empty()) return;
    geometry::Size const output = geometry::checked_size(op, size), source = geometry::checked_size(op, image);
    matrix_tensor = matrices ? *matrices : chain_matrix(op, columns, plan.transforms, plan.transform_numbers);
    sampling.emplace(op, plan.interpolation, plan.padding, plan.align_corners, image, fill);
    matrix.emplace(op, *matrix_tensor, image, image.size(0), true, false, plan.align_corners, source, output);
  }

  static Tensor columns_of(char const* op, Tensor const& image, OptionalTensor const& columns) {
    check_images(op, "image", image);
    if (!columns) return empty({image.size(0), 0}, image, Layout::planar, compute_dtype(image));
    KV_CHECK(columns->dim() == 2 && columns->size(0) == image.size(0) && columns->device() == image.device() &&
                 columns->scalar_type() == compute_dtype(image),
             op, ": expected columns of shape (B, P), of the type that computes, on the device of the images");
    return *columns;
  }

  // The program on images like `x`.
  color::ProgramArguments program(Tensor const& x, ScalarType result) const {
    color::ProgramArguments a(op, x, plan.program, plan.numbers, result, !plan.order.empty());
    a.add_columns(op, x, columns);
    a.check_columns(op, plan.program);
    a.set_order(op, plan.order);
    return a;
  }

  // Whether the kernel that joins warp and program serves images.
  bool is_joined(Tensor const& image, color::ProgramArguments const& a) const {
    int64_t const channels = image.size(1);
    if (a.in_double || plan.antialias || !(channels == 3 || (channels == 1 && a.per_value))) return false;
#if defined(KV_CUDA)
    geometry::Size const size = matrix->use.output;
    return sampling->interpolation == geometry::Interpolation::bilinear &&
           // Special case, H200: 1.14 to 1.37 times as fast as a warp and a program.
           keeps_rows(plan.transforms, plan.transform_numbers) &&
           (a.sequence.contrast < 0 || cuda::keeps_samples(size.height, size.width));
#else
    // Special case: 1.2 times as fast as a warp and a program where floats are rotated, 0.9 to 1.1 for bytes and crops.
    // A mean needs all pixels before the first is written: bands would be sampled twice, in 1.3 to 1.5 times the time.
    return sampling->interpolation != geometry::Interpolation::bicubic && a.sequence.contrast < 0;
#endif
  }
  // Whether the kernel serves that reads pixels where the images of pieces are.
  bool reads_pieces([[maybe_unused]] Tensor const& image, [[maybe_unused]] Tensor const& pieces,
                    [[maybe_unused]] color::ProgramArguments const& a) const {
#if defined(KV_CUDA)
    // Special case, H200: 1.06 (float16) to 1.48 times as fast as pasting, a warp and a program.
    return image.size(1) == 3 && pieces.size(1) <= kMaxReadPieces && !a.in_double && a.sequence.contrast < 0 &&
           !plan.antialias && sampling->interpolation == geometry::Interpolation::bilinear &&
           sampling->padding == geometry::Padding::fill;
#else
    return false;
#endif
  }
  // Whether the gradient of the image has a kernel for warps that map rows to rows.
  bool has_row_gradient([[maybe_unused]] Tensor const& image) const {
#if defined(KV_CUDA)
    return !plan.antialias && sampling->interpolation == geometry::Interpolation::bilinear &&
           sampling->padding != geometry::Padding::reflection && image.scalar_type() != ScalarType::Double &&
           keeps_rows(plan.transforms, plan.transform_numbers) &&
           // Special case, H200: 1.23 (crop+flip+jitter backward) to 2.6 (crop backward) times as fast as the gradient
           // of any warp.
           cuda::fits_block(matrix->use.source, matrix->use.output);
#else
    return false;
#endif
  }
  // What the warp samples.
  Tensor sampled(PassImages const& images) const {
    if (plan.antialias) return windows(images);
    if (!images.list) return geometry::warped(images.like, *sampling, *matrix);
    geometry::Size const size = matrix->use.output;
    return geometry::warped_list(*images.list, *sampling, *matrix, {size.height, size.width})[0];
  }
  // The antialiased windows, which may be written to `memory`.
  Tensor windows(PassImages const& images, OptionalTensor const& memory = {}) const {
    std::vector<int64_t> const size{matrix->use.output.height, matrix->use.output.width};
    auto const resized = [&](auto const& x) {
      return geometry::windows_resized(op, x, *matrix_tensor, size, plan.interpolation, plan.align_corners, false,
                                       memory);
    };
    return images.list ? resized(*images.list)[0] : resized(images.like);
  }
  // The gradient of the image from that of what is sampled.
  Tensor image_gradient(Tensor const& grad, Tensor const& image) const {
    geometry::Size const source = matrix->use.source;
    if (plan.antialias)
      return geometry::windows_resized(op, is_expanded_scalar(grad) ? grad : dense(grad), *matrix_tensor,
                                       {source.height, source.width}, plan.interpolation, plan.align_corners, true);
#if defined(KV_CUDA)
    if (has_row_gradient(image)) {
      int64_t const batch = image.size(0);
      Tensor const result = empty({batch, image.size(1), source.height, source.width}, image);
      dispatch_floating(op, image, [&]<class T>(Type<T>) {
        if constexpr (sizeof(T) < sizeof(double)) {
          WarpRowsBackward<T> const p{{sampling->of<T>(source, matrix->coords<Compute<T>>()),
                                       images<T const>(grad, batch), images<T>(result, batch), nullptr}};
          KV_RUN(warp_rows_backward, image, p, result.numel(), 0);
        }
      });
      return result;
    }
#endif
    return geometry::warp_image_gradient(grad, {image.size(0), source}, *sampling, *matrix);
  }
  // Samples as the kernels take them, of three channels or one.
  color::Samples samples(Tensor const& image) const {
    geometry::Size const size = matrix->use.output;
    return {image.size(0), 1, size.height * size.width, image.size(1) == 1, false};
  }
  template <class T>
  geometry::Sample<T> warp(Tensor const& image) const {
    geometry::Size const source = matrix->use.source, output = matrix->use.output;
    int64_t const batch = image.size(0);
    geometry::Sample<T> const p{sampling->of<T>(source, matrix->coords<Compute<T>>()), images<T const>(image, batch),
                                Images<T>{nullptr, 0, 0, 0, 0, batch, output.height, output.width, int(image.size(1))}};
    geometry::check_planes(op, p.x);
    return p;
  }
};

// A gradient whose rows kernels can read by vectors. An expanded scalar is written to memory, which takes half as long
// as a copy.
Tensor materialized([[maybe_unused]] char const* op, Tensor const& grad) {
  if (!is_expanded_scalar(grad)) return grad;
  Tensor const result = empty(grad.sizes(), grad);
#if defined(KV_CUDA)
  dispatch_floating(op, grad, [&]<class T>(Type<T>) {
    BroadcastScalar<T> const p{data_ptr<T const>(grad), data_ptr<T>(result), result.numel()};
    KV_RUN(broadcast_scalar, grad, p, p.count, 1);
  });
#endif
  return result;
}

template <class T>
void run_batch([[maybe_unused]] Tensor const& image, WarpAndColor<T> const& p, [[maybe_unused]] int64_t bands) {
  KV_RUN(warp_and_color, image, p, p.warp.y.batch * bands, 6 * p.warp.y.channels * kBandPixels);
}
// Tables of at most kMaxListed images, one after the other.
template <class T>
void run_list(char const* op, Tensors const& images, WarpAndColor<T> const& p, [[maybe_unused]] int64_t bands) {
  WarpAndColorList<T> list;
  static_cast<WarpAndColor<T>&>(list) = p;
  for (size_t first = 0; first < images.size(); first += kMaxListed) {
    list.first = int64_t(first);
    list.count = int(std::min(images.size() - first, size_t(kMaxListed)));
    for (int i = 0; i < list.count; ++i)
      list.images[i] = geometry::checked_planes(op, listed(images[first + size_t(i)]));
    KV_RUN(warp_and_color_list, images[first], list, list.count * bands, 6 * p.warp.y.channels * kBandPixels);
  }
}

template <class T>
void run_pieces([[maybe_unused]] Tensor const& image, [[maybe_unused]] Tensor const& pieces,
                [[maybe_unused]] WarpAndColor<T> const& p) {
#if defined(KV_CUDA)
  Tensor const own = dense(pieces);
  WarpPieces<T> const params{p, data_ptr<float const>(own), int(own.size(1)), stride_of_pieces(own)};
  KV_RUN(warp_pieces, image, params, p.warp.y.batch, 0);
#endif
}

// The result and the means of contrast.
std::tuple<Tensor, Tensor> run_joined(WarpAndColorArguments const& a, PassImages const& pass_images,
                                      color::ProgramArguments const& arguments) {
  Tensor const& image = pass_images.like;
  color::PlanArgument const& plan = a.plan.program;
  geometry::Size const size = a.matrix->use.output;
  ScalarType const type = color::result_type(plan, image);
  Layout const layout = plan.layout < 0 ? layout_of(image) : plan.layout == 0 ? Layout::planar : Layout::channels_last;
  int64_t const batch = image.size(0), channels = arguments.sequence.one_channel ? 1 : image.size(1);
  Tensor const y =
      empty({batch, channels, size.height, size.width}, image, channels == 1 ? Layout::planar : layout, type);
  bool const around_mean = arguments.sequence.contrast >= 0;
  Tensor const means = empty({batch, around_mean ? 1 : 0}, image, Layout::planar, ScalarType::Float);
  color::Samples const samples = a.samples(image);
  dispatch_joined(a.op, image, [&]<class T>(Type<T>) {
    WarpAndColor<T> p{a.warp<T>(image), color::program_of<float>(arguments, samples, a.plan.numbers, plan.columns)};
    color::Program<float>& program = p.program;
    program.y = samples.pixels_of(a.op, y, channels == 1 ? Layout::planar : layout);
    if (around_mean) program.means = data_ptr<float>(means);
    if (y.numel() == 0) return;
    int64_t const bands = bands_of(size.height, size.width);  // of a sample, on the CPU
    if (pass_images.pieces) return run_pieces(image, *pass_images.pieces, p);
    pass_images.list ? run_list(a.op, *pass_images.list, p, bands) : run_batch(image, p, bands);
  });
  return {y, means};
}

}  // namespace

PassResults run_pass(PassImages const& images, OptionalTensor const& columns, OptionalTensor const& fill,
                     OptionalTensor const& matrices, std::vector<int64_t> const& size, std::vector<int64_t> const& plan,
                     Numbers const& numbers) {
  Tensor const& image = images.like;
  KV_CHECK(!images.list || !size.empty(), "warp_and_color_list: expected a size of the results");
  WarpAndColorArguments const a("warp_and_color", image, columns, fill, matrices, size, plan, numbers);
  color::PlanArgument const& program = a.plan.program;
  bool const same = program.dtype < 0 && (program.layout < 0 || program.layout == int64_t(layout_of(image)));
  if (a.matrix && same && !a.plan.has_steps() && !images.pieces) return {a.sampled(images), a.matrix_tensor, {}};
  auto const arguments = a.program(image, color::result_type(program, image));
  bool const around_mean = arguments.sequence.contrast >= 0;
  if (images.pieces && !(a.matrix && a.reads_pieces(image, *images.pieces, arguments)))
    return run_pass(pasted(image, *images.pieces, {image.size(2), image.size(3)}), columns, fill, a.matrix_tensor, size,
                    plan, numbers);
  if (a.matrix && (images.pieces || a.is_joined(image, arguments))) {
    auto const [y, means] = run_joined(a, images, arguments);
    return {y, a.matrix_tensor, around_mean ? OptionalTensor(means) : OptionalTensor()};
  }
#if defined(KV_CUDA)
  if (a.matrix && a.plan.antialias && around_mean) {
    geometry::Size const output = a.matrix->use.output;
    auto const results = color::run_program_in_result(a.op, image, {output.height, output.width}, arguments, program,
                                                      a.plan.numbers, [&](Tensor const& x) { a.windows(images, x); });
    if (results) return {std::get<0>(*results), a.matrix_tensor, std::get<1>(*results)};
  }
#endif
  bool const samples = a.matrix.has_value();
  Tensor const x = samples ? a.sampled(images) : image;
  auto const [y, means] = color::run_program(a.op, x, arguments, program, a.plan.numbers, samples);
  return {y, a.matrix_tensor, around_mean ? OptionalTensor(means) : OptionalTensor()};
}

ListResults run_pass_to_list(PassImages const& images, OptionalTensor const& columns, OptionalTensor const& fill,
                             OptionalTensor const& matrices, bool warps, std::vector<int64_t> const& of_each,
                             std::vector<int64_t> const& plan, Numbers const& numbers) {
  constexpr char const* op = "warp_and_color_to_list";
  Tensors const& list = *images.list;
  Tensor const& like = images.like;
  std::vector<int64_t> sides = of_each;
  if (of_each.empty())
    for (Tensor const& x : list) sides.insert(sides.end(), {x.size(1), x.size(2)});
  KV_CHECK(sides.size() == 2 * list.size() && (warps || of_each.empty()), op,
           ": expected the sizes of the results of a warp, got ", of_each.size(), " numbers for ", list.size(),
           " images");
  std::vector<int64_t> const size(sides.begin(),
                                  sides.begin() + (warps ? 2 : 0));  // is checked, and that of each taken
  WarpAndColorArguments const a(op, like, columns, fill, matrices, size, plan, numbers);
  color::PlanArgument const& program = a.plan.program;
  KV_CHECK(program.layout < 0, op, ": expected results of the layout of images");
  geometry::ListSizes const sizes(op, sides, list.size());
  ScalarType const type = color::result_type(program, like);
  auto const arguments = a.program(like, type);
  int64_t const channels = arguments.sequence.one_channel ? 1 : like.size(1);
  Layout const out = layout_of(like);
  Layout in = out;
  bool in_place = false;
#if defined(KV_CUDA)
  in_place = warps && channels == like.size(1) && type == like.scalar_type();
#else
  if (warps && a.is_joined(like, arguments)) in = Layout::planar;  // as the bands of a batch, for the same bits
#endif
  Tensors sampled = list;
  if (warps) {
    bool const is_all = program.dtype < 0 && !a.plan.has_steps();
    if (is_all || a.plan.antialias) in = out;
    if (a.plan.antialias) {
      sampled = geometry::windows_resized(op, list, *a.matrix_tensor, sides, a.plan.interpolation, a.plan.align_corners,
                                          false);
      if (Tensor const x = sampled[0]; x.dim() == 4)  // of a list of one
        sampled[0] = view_of(x, {x.size(1), x.size(2), x.size(3)}, {x.stride(1), x.stride(2), x.stride(3)});
    } else {
      sampled = geometry::empty_list(like, like.size(1), sizes, list.size(), in);
      geometry::warp_to(sampled, in, list, *a.sampling, *a.matrix, sizes);
    }
    if (is_all) return {sampled, a.matrix_tensor, {}};
  }
  Tensors const results =
      in_place ? sampled
               : geometry::empty_list(like, channels, sizes, list.size(), channels == 1 ? Layout::planar : out, type);
  Tensor const means = color::run_program_on_list(op, sampled, in, results, like, arguments, program, a.plan.numbers);
  bool const around_mean = arguments.sequence.contrast >= 0;
  return {results, a.matrix_tensor, around_mean ? OptionalTensor(means) : OptionalTensor()};
}

namespace {

// Missing matrices are (B, 0, 3), and missing means are (B, 0).
using Results = std::tuple<Tensor, Tensor, Tensor>;
Tensor matrix_or_none(Tensor const& image, OptionalTensor const& x) {
  return x ? *x : empty({image.size(0), 0, 3}, image, Layout::planar, compute_dtype(image));
}
Tensor means_or_none(Tensor const& image, OptionalTensor const& x) {
  return x ? *x : empty({image.size(0), 0}, image, Layout::planar, compute_dtype(image));
}
Results run_and_fill(PassImages const& images, OptionalTensor const& columns, OptionalTensor const& fill,
                     std::vector<int64_t> const& size, std::vector<int64_t> const& plan, Numbers const& numbers) {
  Tensor const& image = images.like;
  auto const [y, matrix, means] = run_pass(images, columns, fill, {}, size, plan, numbers);
  return {y, matrix_or_none(image, matrix), means_or_none(image, means)};
}

Results warp_and_color(Tensor const& image, OptionalTensor const& columns, OptionalTensor const& fill,
                       std::vector<int64_t> const& size, std::vector<int64_t> const& plan, Numbers const& numbers) {
  return run_and_fill(image, columns, fill, size, plan, numbers);
}
Results warp_and_color_list(Tensors const& images, OptionalTensor const& columns, OptionalTensor const& fill,
                            std::vector<int64_t> const& size, std::vector<int64_t> const& plan,
                            Numbers const& numbers) {
  return run_and_fill({"warp_and_color_list", images}, columns, fill, size, plan, numbers);
}

std::tuple<Tensor, Tensor> warp_and_color_pieces(Tensor const& image, Tensor const& pieces,
                                                 OptionalTensor const& columns, OptionalTensor const& fill,
                                                 std::vector<int64_t> const& size, std::vector<int64_t> const& plan,
                                                 Numbers const& numbers) {
  check_pieces("warp_and_color_pieces", image, pieces);
  auto const [y, matrix, means] = run_pass({image, pieces}, columns, fill, {}, size, plan, numbers);
  return {y, matrix_or_none(image, matrix)};
}

Tensors warp_and_color_to_list(Tensors const& images, OptionalTensor const& columns, OptionalTensor const& fill,
                               bool warps, std::vector<int64_t> const& sizes, std::vector<int64_t> const& plan,
                               Numbers const& numbers) {
  PassImages const list("warp_and_color_to_list", images);
  auto [results, matrix, means] = run_pass_to_list(list, columns, fill, {}, warps, sizes, plan, numbers);
  results.push_back(matrix_or_none(list.like, matrix));
  results.push_back(means_or_none(list.like, means));
  return results;
}

// The gradients of the image, of the columns that the program reads, and of the matrices. One that is not required has
// no elements.
std::tuple<Tensor, Tensor, Tensor> warp_and_color_backward(Tensor const& grad, Tensor const& image,
                                                           OptionalTensor const& columns, OptionalTensor const& fill,
                                                           Tensor const& matrix, Tensor const& means,
                                                           std::vector<int64_t> const& size,
                                                           std::vector<int64_t> const& plan, Numbers const& numbers,
                                                           bool of_image, bool of_columns) {
  char const* const op = "warp_and_color_backward";
  OptionalTensor const matrices = size.empty() ? OptionalTensor() : OptionalTensor(matrix);
  WarpAndColorArguments const a(op, image, columns, fill, matrices, size, plan, numbers);
  check_images(op, "grad", grad);
  bool const of_matrix = of_columns && a.matrix, through = of_image || of_matrix;
  int64_t const height = a.matrix ? a.matrix->use.output.height : image.size(2),
                width = a.matrix ? a.matrix->use.output.width : image.size(3);
  KV_CHECK(grad.size(0) == image.size(0) && grad.size(2) == height && grad.size(3) == width &&
               grad.device() == image.device() && grad.scalar_type() != ScalarType::Byte &&
               image.scalar_type() != ScalarType::Byte,
           op, ": grad does not fit the result for this image");
  Tensor const none = empty({image.size(0), 0}, a.columns);
  Tensor sampled_grad = grad, grad_columns = none;
  if (a.plan.has_steps() || grad.scalar_type() != image.scalar_type()) {
    auto const arguments = a.program(image, grad.scalar_type());
    KV_CHECK(!of_columns || arguments.columns <= color::kMaxParameters, op, ": expected at most ",
             color::kMaxParameters, " columns, got ", arguments.columns);
    KV_CHECK(grad.size(1) == (arguments.sequence.one_channel ? 1 : image.size(1)), op,
             ": grad does not fit the result for this image");
    bool const of_parameters = of_columns && arguments.columns > 0;
    color::RequiredGradients const required{through, of_parameters};
    Tensor const x = a.matrix ? a.sampled(image) : image;
    auto const around = arguments.sequence.contrast >= 0 ? OptionalTensor(means) : OptionalTensor();
    auto const [of_sampled, of_program] =
        color::program_gradients(op, grad, x, arguments, a.plan.program, a.plan.numbers, around, required);
    sampled_grad = of_sampled;
    if (of_parameters) grad_columns = torch::stable::squeeze(of_program, 1);
  }
  Tensor grad_image = none, grad_matrix = empty({image.size(0), 0, 3}, a.columns);
  if (!a.matrix) {
    if (of_image) grad_image = sampled_grad;
  } else {
    bool const reads_number = a.plan.antialias || (!of_matrix && a.has_row_gradient(image));
    if (!reads_number) sampled_grad = materialized(op, sampled_grad);
    if (of_image) grad_image = a.image_gradient(sampled_grad, image);
    if (of_matrix && a.plan.antialias) {  // windows are whole pixels
      grad_matrix = empty({image.size(0), 3, 3}, a.columns);
      torch::stable::zero_(grad_matrix);
    } else if (of_matrix) {
      grad_matrix = geometry::warp_matrix_gradient(sampled_grad, image, *a.sampling, *a.matrix);
    }
  }
  return {grad_image, grad_columns, grad_matrix};
}

// The gradients of the images of a list of a program without a warp. The list has the images, and behind them the
// gradients of the results.
Tensors color_list_backward(Tensors const& images_and_grads, OptionalTensor const& columns, OptionalTensor const& means,
                            std::vector<int64_t> const& plan, Numbers const& numbers) {
  char const* const op = "color_list_backward";
  auto const [images, grads] = halves(op, images_and_grads);
  PassImages const list(op, images);
  check_image_list(op, "grads", grads);
  WarpAndColorArguments const a(op, list.like, columns, {}, {}, {}, plan, numbers);
  auto const arguments = a.program(list.like, grads[0].scalar_type());
  std::vector<int64_t> sides;
  for (Tensor const& x : images) sides.insert(sides.end(), {x.size(1), x.size(2)});
  Tensors const results = geometry::empty_list(list.like, list.like.size(1), {op, sides, images.size()}, images.size(),
                                               layout_of(list.like));
  color::program_list_gradients(op, grads, images, results, list.like, arguments, a.plan.program, a.plan.numbers,
                                means);
  return results;
}

}  // namespace

// A warp by the matrices of a chain of transforms of columns (B, P), then a program of color steps: the result, the
// matrices, and the means of contrast. warp_and_color.py explains size, plan and numbers.
KV_OPERATOR(warp_and_color,
            "(Tensor image, Tensor? columns, Tensor? fill, SymInt[] size, int[] plan, float[] numbers) "
            "-> (Tensor, Tensor, Tensor)")
// The same of images (C, H, W) of different sizes, to which the warp gives one size.
KV_OPERATOR(warp_and_color_list,
            "(Tensor[] images, Tensor? columns, Tensor? fill, SymInt[] size, int[] plan, float[] numbers) "
            "-> (Tensor, Tensor, Tensor)")
// The result and the matrices for images that are copies of pieces (B, N, 9) of the images of a batch, of their size.
KV_OPERATOR(warp_and_color_pieces,
            "(Tensor image, Tensor pieces, Tensor? columns, Tensor? fill, SymInt[] size, int[] plan, float[] numbers) "
            "-> (Tensor, Tensor)")
// The same of images of different sizes, whose results are a list. `warps` says whether there is a warp, and `sizes`
// has height and width of each result of it; without these images keep theirs. Behind the results are the matrices and
// the means.
KV_OPERATOR(warp_and_color_to_list,
            "(Tensor[] images, Tensor? columns, Tensor? fill, bool warps, SymInt[] sizes, int[] plan, float[] numbers) "
            "-> Tensor[]")
KV_OPERATOR(color_list_backward,
            "(Tensor[] images_and_grads, Tensor? columns, Tensor? means, int[] plan, float[] numbers) -> Tensor[]")
KV_OPERATOR(warp_and_color_backward,
            "(Tensor grad, Tensor image, Tensor? columns, Tensor? fill, Tensor matrix, Tensor means, SymInt[] size, "
            "int[] plan, float[] numbers, bool of_image, bool of_columns) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::augmentation
