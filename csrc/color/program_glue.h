// The arguments of color programs, and their runs. Included by program_op.cpp, augmentation/warp_and_color_op.cpp and
// enhance/sharpness_op.cpp, which sums gradients of parameters in the same way.
#pragma once

#include <algorithm>
#include <array>
#include <span>

#include "glue/expanded_scalar.h"
#include "glue/views.h"
#include "luma.h"
#include "program.h"
#include "program_clusters.h"

namespace kv::color {

// Sums `p.partial` to `p.sums` on the device of x.
template <class F>
void reduce_gradients([[maybe_unused]] Tensor const& x, ProgramReduce<F> const& p) {
  KV_RUN(program_reduce, x, p, p.count, p.summands);
}

using OptionalTensor = std::optional<Tensor>;

// --- the arguments of the operators ----------------------------------------------------------------------------------

// The schemas' `plan`. It is one list because every argument of an operator costs a call a tenth of a small kernel's
// launch.
struct PlanArgument {
  int64_t dtype, layout;  // of the result: a DType, 0 for NCHW and 1 for NHWC, or -1 for that of the input
  std::span<int64_t const> steps;
  std::span<int64_t const> columns;  // of the parameters in the tensors, or -1; empty without tensors
};

inline PlanArgument parse_plan(char const* op, std::vector<int64_t> const& plan) {
  std::span<int64_t const> const all(plan);
  KV_CHECK(all.size() >= 3 && all[2] >= 0 && uint64_t(all[2]) <= all.size() - 3, op,
           ": expected a plan of a dtype, a layout, the number of steps and as many steps");
  size_t const count = size_t(all[2]);
  KV_CHECK(count <= kMaxSteps, op, ": expected at most ", kMaxSteps, " steps, got ", count);
  KV_CHECK(all[0] >= -1 && all[0] <= int64_t(DType::float64), op, ": there is no dtype ", all[0]);
  KV_CHECK(all[1] >= -1 && all[1] <= 1, op, ": there is no layout ", all[1]);
  return {all[0], all[1], all.subspan(3, count), all.subspan(3 + count)};
}

struct StepSequence {
  std::vector<Step> steps;
  int contrast = -1;         // position of the first one
  bool per_value = true;     // no step mixes channels; a mean over several channels still does
  bool one_channel = false;  // of the result
  int64_t parameters = 0;
};

inline StepSequence check_steps(char const* op, PlanArgument const& plan, size_t numbers, bool ordered) {
  size_t const columns = plan.columns.size();
  StepSequence sequence;
  for (int64_t number : plan.steps) {
    KV_CHECK(number >= 0 && number < kStepCount, op, ": there is no step ", number);
    KV_CHECK(!sequence.one_channel, op, ": a step whose result has one channel must be the last one");
    Step const step = Step(number);
    KV_CHECK(step != Step::contrast || sequence.contrast < 0 || ordered, op,
             ": expected one step around a mean at most, or an order that has one");
    if (step == Step::contrast && sequence.contrast < 0) sequence.contrast = int(sequence.steps.size());
    sequence.per_value = sequence.per_value && is_per_value(step);
    sequence.one_channel = outputs_one_channel(step);
    sequence.parameters += parameters_of(step);
    sequence.steps.push_back(step);
  }
  KV_CHECK(int64_t(numbers) == sequence.parameters && sequence.parameters <= kMaxParameters, op, ": expected ",
           sequence.parameters, " numbers and at most ", kMaxParameters, ", got ", numbers);
  KV_CHECK(columns == 0 || columns == numbers, op, ": expected a column for each of ", numbers, " numbers, got ",
           columns);
  return sequence;
}

// `x` itself, or a dense copy: the pixels of an image are one row then.
inline Tensor as_pixel_rows(Tensor const& x, Layout layout) {
  if (layout == Layout::channels_last)
    return x.stride(0) == x.stride(2) * x.size(2) || x.size(0) == 1 ? x : as_layout(dense(x), layout);
  return dense(x);
}

// --- samples and parameters ------------------------------------------------------------------------------------------

// A sample is a range of pixels with the same parameters: an image of three channels; or, if no step mixes channels, a
// plane, an image or the whole batch.
struct Samples {
  int64_t count, inner, pixels;
  bool per_value, per_plane;

  int channels() const { return per_value ? 1 : 3; }
  Pixels pixels_of(char const* op, Tensor const& x, Layout layout) const {
    auto* const data = const_cast<void*>(x.const_data_ptr());
    bool const last = layout == Layout::channels_last;
    int64_t const c = x.size(1), n = x.size(2) * x.size(3);
    DType const type = dtype_of(op, x);
    if (!per_value) return {data, type, int(c), 1, n * c, 0, last ? 1 : n, last ? c : 1};
    if (!per_plane) return {data, type, 1, 1, pixels, 0, 0, 1};
    return {data, type, 1, inner, n * c, last ? 1 : n, 0, last ? c : 1};
  }
};

// The checked arguments of a program.
struct ProgramArguments {
  StepSequence sequence;
  OptionalTensor order;
  std::span<int64_t const> order_of_columns;
  std::vector<ParameterTensor> tensors;
  int64_t columns = 0;  // of all tensors
  bool by_channel = false;
  bool per_value;
  bool in_double;  // the compute type

  // Without tensors of parameters and without an order, which the members below add; `ordered` tells that there will be
  // one.
  ProgramArguments(char const* op, Tensor const& x, PlanArgument const& plan, std::vector<double> const& numbers,
                   ScalarType result, bool ordered)
      : sequence(check_steps(op, plan, numbers.size(), ordered)) {
    check_images(op, "input", x);
    int64_t const c = x.size(1);
    per_value = sequence.per_value && (sequence.contrast < 0 || c == 1);
    KV_CHECK(per_value || c == 3, op, ": expected input of 3 channels, got ", c);
    in_double = x.scalar_type() == ScalarType::Double;
    KV_CHECK(in_double == (result == ScalarType::Double), op, ": float64 goes with float64 only");
    KV_CHECK(!ordered || !sequence.one_channel, op, ": a program whose result has one channel takes no order");
  }

  // (B, S), of which each row has the steps of an image in their order.
  void set_order(char const* op, Tensor const& x, Tensor const& steps) {
    KV_CHECK(steps.dim() == 2 && (steps.size(0) == 1 || steps.size(0) == x.size(0)) && steps.size(1) <= kMaxSteps, op,
             ": expected order of shape (B, S) with at most ", kMaxSteps, " positions");
    KV_CHECK(steps.scalar_type() == ScalarType::Long && steps.device() == x.device(), op,
             ": expected order of int64, on the device of input");
    order = dense(steps);
  }
  // For each position a column of the tensors, or -1, and the step to which its number is added.
  void set_order(char const* op, std::span<int64_t const> pairs) {
    KV_CHECK(pairs.size() % 2 == 0 && pairs.size() / 2 <= kMaxSteps, op, ": expected an order of at most ", kMaxSteps,
             " positions");
    for (size_t i = 0; i < pairs.size(); i += 2)
      KV_CHECK(pairs[i] >= -1 && pairs[i] < columns && pairs[i + 1] >= 0 && pairs[i + 1] < kMaxSteps, op,
               ": there are no such column and step for the order");
    order_of_columns = pairs;
  }
  // After all tensors of parameters.
  void check_columns(char const* op, PlanArgument const& plan) const {
    size_t at = 0;
    for (Step const step : sequence.steps)
      for (int i = 0; i < parameters_of(step) && !plan.columns.empty(); ++i, ++at) {
        KV_CHECK(plan.columns[at] < columns, op, ": there are no parameters for the columns that are asked for");
        KV_CHECK(plan.columns[at] < 0 || takes_tensors(step), op, ": step ", int(step), " takes numbers only");
        // Gradients follow from the number.
        bool const clips = (kClippedAffineSteps >> int(step) & 1) && i + 1 == parameters_of(step);
        KV_CHECK(plan.columns[at] < 0 || !clips, op, ": whether a step clips is a number, no column");
      }
  }

  void add_tensor(char const* op, Tensor const& x, Tensor const& p) {
    KV_CHECK(p.dim() == 3, op, ": expected parameters of shape (B, C, P), got ", p.dim(), " axes");
    int64_t const images = p.size(0), channels = p.size(1), count = p.size(2);
    KV_CHECK((images == 1 || images == x.size(0)) && (channels == 1 || (channels == x.size(1) && per_value)) &&
                 columns + count <= kMaxParameters,
             op, ": parameters of shape (", images, ", ", channels, ", ", count, ") do not fit the images");
    DType const type = dtype_of(op, p);
    KV_CHECK(p.device() == x.device() && type != DType::uint8, op,
             ": expected parameters of floating-point numbers, on the device of input");
    auto const stride = [&](int64_t axis) { return p.size(axis) == 1 ? 0 : p.stride(axis); };
    tensors.push_back({p.const_data_ptr(), type, int(columns), stride(0), stride(1), stride(2)});
    columns += count;
    by_channel = by_channel || channels > 1;
  }
  // (B, P), the same for all channels, of which the program may use a part.
  void add_columns(char const* op, Tensor const& x, Tensor const& p) {
    DType const type = dtype_of(op, p);
    KV_CHECK(p.dim() == 2 && p.size(0) == x.size(0) && p.device() == x.device() && type != DType::uint8, op,
             ": expected columns of floating-point numbers, of shape (B, P), on the device of the images");
    tensors.push_back({p.const_data_ptr(), type, 0, p.size(0) == 1 ? 0 : p.stride(0), 0, p.stride(1)});
    columns = p.size(1);
  }
  bool is_ordered() const { return order || !order_of_columns.empty(); }

  template <class Run>
  void dispatch_compute(Run run) const {
    in_double ? run(Type<double>{}) : run(Type<float>{});
  }

  Samples samples(Tensor const& x, bool same_layout) const {
    return samples(x.size(0), x.size(1), x.size(2) * x.size(3), same_layout);
  }
  // Of b images of c planes of n pixels.
  Samples samples(int64_t b, int64_t c, int64_t n, bool same_layout) const {
#if defined(KV_CUDA)
    bool const pixels = c == 3 && !by_channel;  // a thread takes three times as many values
#else
    // Planes of a size that is no multiple of 16 do not start at multiples of a vector.
    bool const pixels = c == 3 && !by_channel && (!same_layout || n % 16 == 0);
#endif
    if (!per_value || pixels) return {b, 1, n, false, false};
    if (by_channel || !same_layout) return {b * c, c, n, true, true};
    bool const by_image = sequence.contrast >= 0 || !tensors.empty() || is_ordered();
    return by_image ? Samples{b, 1, c * n, true, false} : Samples{1, 1, b * c * n, true, false};
  }
};

template <class F>
Program<F> program_of(ProgramArguments const& a, Samples const& samples, std::vector<double> const& numbers,
                      std::span<int64_t const> columns) {
  StepSequence const& sequence = a.sequence;
  OptionalTensor const& order = a.order;
  Program<F> p{};
  p.samples = samples.count;
  p.pixels = samples.pixels;
  p.inner = samples.inner;
  p.steps = int(sequence.steps.size());
  p.count = int(numbers.size());
  p.contrast = sequence.contrast;
  p.parts_count = mean_parts_of<F>(p.samples, p.pixels);
  for (int i = 0, at = 0; i < p.steps; at += parameters_of(p.step[i++])) {
    p.step[i] = sequence.steps[size_t(i)];
    p.first[i] = at;
  }
  for (int i = 0; i < p.count; ++i) {
    p.numbers[i] = F(numbers[size_t(i)]);
    p.column[i] = columns.empty() ? -1 : int(columns[size_t(i)]);
  }
  p.tensor_count = int(a.tensors.size());
  std::copy(a.tensors.begin(), a.tensors.end(), p.tensor);
  bool const rgb = samples.channels() == 3;
  constexpr double kWeights[] = {kLumaRed, kLumaGreen, kLumaBlue};
  for (int k = 0; k < 3; ++k) p.gray_weights[k] = F(rgb ? kWeights[k] : k == 0);
  p.mean_pixels = p.pixels;
  p.length = p.steps;
  if (!a.order_of_columns.empty()) {
    p.ordered_by_columns = true;
    p.length = int(a.order_of_columns.size() / 2);
    for (int i = 0; i < p.length; ++i) {
      p.order_column[i] = int(a.order_of_columns[2 * size_t(i)]);
      p.order_first[i] = int(a.order_of_columns[2 * size_t(i) + 1]);
    }
  }
  if (order) {
    p.order = static_cast<int64_t const*>(order->const_data_ptr());
    p.order_stride = order->size(0) == 1 ? 0 : order->size(1);
    p.length = int(order->size(1));
  }
  return p;
}

// --- runs ------------------------------------------------------------------------------------------------------------

inline ScalarType result_type(PlanArgument const& plan, Tensor const& input) {
  return plan.dtype < 0 ? input.scalar_type() : scalar_type_of(DType(plan.dtype));
}

// The result, and the means that contrast was taken around. On CUDA a result like the input overwrites an input that
// the caller `owns`, because a thread reads its pixels before it writes them. On the CPU the last vectors of a row
// overlap.
inline std::tuple<Tensor, Tensor> run_program(char const* op, Tensor const& input, ProgramArguments const& a,
                                              PlanArgument const& plan, std::vector<double> const& numbers,
                                              [[maybe_unused]] bool owns = false) {
  ScalarType const type = result_type(plan, input);
  Layout const in = layout_of(input);
  Layout const out = plan.layout < 0 ? in : plan.layout == 0 ? Layout::planar : Layout::channels_last;
  Tensor const x = as_pixel_rows(input, in);
  int64_t const channels = a.sequence.one_channel ? 1 : x.size(1);
#if defined(KV_CUDA)
  bool const in_place = owns && in == out && channels == x.size(1) && type == x.scalar_type();
#else
  constexpr bool in_place = false;
#endif
  Tensor const y =
      in_place ? x : empty({x.size(0), channels, x.size(2), x.size(3)}, x, channels == 1 ? Layout::planar : out, type);
  Samples const samples = a.samples(x, in == out);
  ScalarType const computes = a.in_double ? ScalarType::Double : ScalarType::Float;
  bool const around_mean = a.sequence.contrast >= 0;
  Tensor const means = around_mean ? empty({samples.count, 1}, x, Layout::planar, computes) : x;
  a.dispatch_compute([&](auto type) {
    using F = typename decltype(type)::type;
    Program<F> p = program_of<F>(a, samples, numbers, plan.columns);
    p.x = samples.pixels_of(op, x, in);
    p.y = samples.pixels_of(op, y, out);
    [[maybe_unused]] int64_t const cost = 3 * min(kChunk<F>, p.pixels);
    Tensor parts;
    if (around_mean) {
      p.means = static_cast<F*>(means.mutable_data_ptr());
#if defined(KV_CUDA)
      if constexpr (sizeof(F) == sizeof(float))
        // Special case, H200: 1.27 (contrast_mean) to 1.50 (jitter) times as fast as two passes.
        if (cuda::takes_clusters(p)) {
          KV_RUN(program_by_clusters, x, p, p.samples, 0);
          return;
        }
#endif
      parts = empty({p.samples, p.parts_count}, means);
      p.parts = static_cast<F*>(parts.mutable_data_ptr());
      p.measures_mean = true;
      KV_RUN(program, x, p, p.samples * p.parts_count, cost);
      p.measures_mean = false;
    }
    KV_RUN(program, x, p, p.samples * chunks_of<F>(p.pixels), cost);
  });
  return {y, means};
}

#if defined(KV_CUDA)
// The same around a mean for pixels (B, C, height, width), of the type and layout of `like`, that `write` puts into the
// memory of the result: nothing is allocated for them. None if no kernel reads a sample before it writes its result, or
// if results are smaller than pixels.
template <class Write>
std::optional<std::tuple<Tensor, Tensor>> run_program_in_result(char const* op, Tensor const& like,
                                                                std::array<int64_t, 2> size, ProgramArguments const& a,
                                                                PlanArgument const& plan,
                                                                std::vector<double> const& numbers, Write write) {
  Layout const in = layout_of(like);
  Layout const out = plan.layout < 0 ? in : plan.layout == 0 ? Layout::planar : Layout::channels_last;
  int64_t const batch = like.size(0), channels = like.size(1), pixels = size[0] * size[1];
  if (a.in_double || a.sequence.one_channel || channels != 3 || batch * pixels == 0) return {};
  Tensor const y = empty({batch, channels, size[0], size[1]}, like, out, result_type(plan, like));
  int64_t const apart = channels * pixels * int64_t(y.element_size()) / int64_t(like.element_size());
  int64_t const planar[] = {apart, pixels, size[1], 1}, last[] = {apart, 1, channels * size[1], channels};
  if (apart < channels * pixels) return {};
  Samples const samples{batch, 1, pixels, false, false};
  Tensor const means = empty({batch, 1}, like, Layout::planar, ScalarType::Float),
               x = in_memory_of(y, like, {batch, channels, size[0], size[1]}, in == Layout::planar ? planar : last);
  Program<float> p = program_of<float>(a, samples, numbers, plan.columns);
  p.x = samples.pixels_of(op, x, in);
  p.x.outer_stride = apart;
  p.y = samples.pixels_of(op, y, out);
  p.means = data_ptr<float>(means);
  p.overwrites = true;
  if (!cuda::takes_clusters(p)) return {};
  write(x);
  KV_RUN(program_by_clusters, like, p, p.samples, 0);
  return std::tuple{y, means};
}
#endif

// Whether parameter i of an affine step is a factor. The others are offsets, or say that nothing is clipped.
inline bool is_factor(Step step, int i) {
  if (step == Step::affine) return i < 9;
  if (step == Step::scale_shift_rgb) return i < 3;
  if (step == Step::standardize_rgb) return i >= 3;
  return step == Step::standardize ? i == 1 : i == 0;
}

// The transpose of an affine program, for its gradient: the transposes of its steps in reverse order.
struct TransposedProgram {
  std::vector<double> numbers;
  std::vector<int64_t> steps, columns;

  TransposedProgram(PlanArgument const& plan, std::vector<double> const& original) {
    size_t end = original.size();
    for (size_t k = plan.steps.size(); k-- > 0;) {
      Step const step = Step(plan.steps[k]);
      int const count = parameters_of(step);
      size_t const first = end - size_t(count);
      steps.push_back(plan.steps[k]);
      for (int i = 0; i < count; ++i) {
        size_t const source = first + size_t(step == Step::affine && i < 9 ? i % 3 * 3 + i / 3 : i);
        bool const scales = is_factor(step, i);
        numbers.push_back(scales ? original[source] : 0);
        if (!plan.columns.empty()) columns.push_back(scales ? plan.columns[source] : -1);
      }
      end = first;
    }
  }
};

// Whether the gradient of the image is a program, too: that of an affine one.
inline bool has_transpose(ProgramArguments const& a, PlanArgument const& plan, std::vector<double> const& numbers) {
  bool affine = !a.is_ordered() && a.sequence.contrast < 0 && !a.sequence.one_channel && plan.steps.size() > 0;
  for (size_t i = 0, at = 0; i < a.sequence.steps.size(); at += size_t(parameters_of(a.sequence.steps[i++])))
    affine = affine && is_affine(a.sequence.steps[i], numbers.data() + at);
  return affine;
}
// The arguments of a transposed program on `grad`, a batch, with the tensors of the program.
inline ProgramArguments transposed_arguments(char const* op, Tensor const& grad, ProgramArguments const& of_program,
                                             PlanArgument const& transposed, std::vector<double> const& numbers) {
  ProgramArguments a(op, grad, transposed, numbers, result_type(transposed, grad), false);
  a.tensors = of_program.tensors;
  a.columns = of_program.columns;
  a.by_channel = of_program.by_channel;
  return a;
}

// Tells which steps' gradients depend on their inputs.
template <class F>
void set_needed_inputs(ProgramBackward<F>& p, bool of_parameters) {
  Program<F> const& q = p.forward;
  for (int i = 0; i < q.steps; ++i) {
    p.needs_input[i] = of_parameters || !is_affine(q.step[i], q.numbers + q.first[i]);
    p.reads_input = p.reads_input || p.needs_input[i];
  }
}

// Which gradients of a program are required.
struct RequiredGradients {
  bool image, parameters;
};

// The gradients of the image and, for each image of the batch, of the parameters. A gradient that is not required has
// no elements. `means` are those of run_program, or nothing for programs without contrast.
inline std::tuple<Tensor, Tensor> program_gradients(char const* op, Tensor const& grad, Tensor const& input,
                                                    ProgramArguments const& a, PlanArgument const& parsed,
                                                    std::vector<double> const& numbers, OptionalTensor const& means,
                                                    RequiredGradients required) {
  auto const [of_image, of_parameters] = required;
  bool same = grad.dim() == 4 && grad.size(1) == (a.sequence.one_channel ? 1 : input.size(1)) &&
              grad.device() == input.device();
  for (int64_t i : {0, 2, 3}) same = same && grad.size(i) == input.size(i);
  KV_CHECK(same, op, ": grad differs in shape or device from the result of input");
  KV_CHECK(grad.scalar_type() != ScalarType::Byte && !(of_image && input.scalar_type() == ScalarType::Byte), op,
           ": bytes have no gradient");
  KV_CHECK(!of_parameters || !a.tensors.empty(), op, ": a gradient of parameters needs parameters that are tensors");
  bool const is_scalar = is_expanded_scalar(grad);
  Layout const in = layout_of(input), out = is_scalar ? in : layout_of(grad);
  Tensor const x = as_pixel_rows(input, in), g = is_scalar ? grad : as_pixel_rows(grad, out);
  Samples const samples = a.samples(x, in == out || grad.size(1) != x.size(1));
  ScalarType const computes = a.in_double ? ScalarType::Double : ScalarType::Float;
  bool const around_mean = a.sequence.contrast >= 0;
  KV_CHECK(around_mean ? (means && means->dim() == 2 && means->size(0) == samples.count && means->size(1) == 1 &&
                          means->scalar_type() == computes && means->device() == x.device())
                       : !means,
           op, ": expected means as color_program_around_mean gives them");
  int64_t const b = x.size(0);
  if (of_image && !of_parameters && has_transpose(a, parsed, numbers)) {
    TransposedProgram const transposed(parsed, numbers);
    PlanArgument const back{int64_t(dtype_of(op, x)), in == Layout::planar ? 0 : 1, transposed.steps,
                            transposed.columns};
    ProgramArguments const of_transposed = transposed_arguments(op, grad, a, back, transposed.numbers);
    return {std::get<0>(run_program(op, grad, of_transposed, back, transposed.numbers)),
            empty({b, 0}, x, Layout::planar, computes)};
  }
  Tensor const grad_x = of_image ? empty_like(x, in) : empty({b, 0}, x);
  int64_t const rows = a.by_channel ? x.size(1) : 1;  // of an image's parameters
  Tensor const grad_parameters = of_parameters ? empty({b, rows, a.columns}, x, Layout::planar, computes)
                                               : empty({b, 0}, x, Layout::planar, computes);
  a.dispatch_compute([&](auto type) {
    using F = typename decltype(type)::type;
    ProgramBackward<F> p{};
    p.forward = program_of<F>(a, samples, numbers, parsed.columns);
    p.forward.x = samples.pixels_of(op, x, in);
    p.grad = samples.pixels_of(op, g, out);
    if (is_scalar) p.grad.outer_stride = p.grad.inner_stride = p.grad.channel_stride = p.grad.step = 0;
    p.needs_grad_x = of_image;
    set_needed_inputs(p, of_parameters);
    if (of_image) p.grad_x = samples.pixels_of(op, grad_x, in);
    int64_t const chunks = chunks_of<F>(samples.pixels), blocks = blocks_per_sample<F>(samples.count, samples.pixels);
    [[maybe_unused]] int64_t const cost = 12 * min(kChunk<F>, samples.pixels);
    Tensor partial_grads, dense_means, parts;
    if (around_mean) {
      dense_means = dense(*means);
      p.forward.means = static_cast<F*>(const_cast<void*>(dense_means.const_data_ptr()));
#if defined(KV_CUDA)
      if constexpr (sizeof(F) == sizeof(float))
        // Special case, H200: 1.34 (crop+flip+jitter backward) to 1.71 (contrast_mean backward) times as fast as two
        // passes.
        if (!of_parameters && cuda::takes_clusters(p)) {
          KV_RUN(program_backward_by_clusters, x, p, samples.count, 0);
          return;
        }
#endif
      parts = empty({samples.count, p.forward.parts_count}, dense_means);
      p.forward.parts = static_cast<F*>(parts.mutable_data_ptr());
      p.forward.measures_mean = true;
#if defined(KV_CUDA)
      p.resumes = of_image && !of_parameters && x.scalar_type() == computes;  // halves would be rounded between runs
#endif
      KV_RUN(program_backward, x, p, samples.count * p.forward.parts_count, cost);
      p.forward.measures_mean = false;
      if (p.resumes) p.grad = p.grad_x;
    }
    if (of_parameters) {
      p.columns = int(a.columns);
      partial_grads = empty({samples.count, blocks, p.columns}, grad_parameters);
      p.partial_grads = static_cast<F*>(partial_grads.mutable_data_ptr());
    }
    KV_RUN(program_backward, x, p, samples.count * chunks, cost);
    if (!of_parameters) return;
    ProgramReduce<F> const sums{p.partial_grads, static_cast<F*>(grad_parameters.mutable_data_ptr()),
                                b * rows * p.columns, samples.inner / rows * blocks, p.columns};
    reduce_gradients(x, sums);
  });
  return {grad_x, grad_parameters};
}

}  // namespace kv::color
