// Colour programs: schemas and entries, for CPU and CUDA alike.
#include <algorithm>
#include <span>

#include "glue/glue.h"
#include "program.h"

namespace kv {
namespace {

using Maybe = std::optional<Tensor>;

// --- what the program is ---------------------------------------------------------------------------------------------

// `plan` of the schemas. One list, as each argument of an operator costs a call a tenth of a small kernel's launch.
struct Recipe {
  int64_t dtype, layout;  // of the result: a DType, 0 for NCHW and 1 for NHWC, or -1 for that of the input
  std::span<int64_t const> steps;
  std::span<int64_t const> columns;  // where parameters stand in the tensors, or -1; empty where there are no tensors
};

Recipe recipe_of(char const* op, std::vector<int64_t> const& plan) {
  std::span<int64_t const> const all(plan);
  KV_CHECK(all.size() >= 3 && all[2] >= 0 && uint64_t(all[2]) <= all.size() - 3, op,
           ": expected a plan of a dtype, a layout, the number of steps and as many steps");
  size_t const count = size_t(all[2]);
  KV_CHECK(count <= kMostSteps, op, ": expected at most ", kMostSteps, " steps, got ", count);
  KV_CHECK(all[0] >= -1 && all[0] <= int64_t(DType::float64), op, ": there is no dtype ", all[0]);
  KV_CHECK(all[1] >= -1 && all[1] <= 1, op, ": there is no layout ", all[1]);
  return {all[0], all[1], all.subspan(3, count), all.subspan(3 + count)};
}

using Parameters = std::initializer_list<Maybe const*>;

struct Plan {
  std::vector<Step> steps;
  int contrast = -1;   // where the first one is
  bool values = true;  // every step treats the channels alike, if there is only one or no mean of them
  bool sums = false;   // one channel comes out
  int64_t parameters = 0;
};

Plan plan_of(char const* op, Recipe const& recipe, size_t numbers, bool ordered) {
  size_t const columns = recipe.columns.size();
  Plan plan;
  for (int64_t number : recipe.steps) {
    KV_CHECK(number >= 0 && number < int64_t(Step::count), op, ": there is no step ", number);
    KV_CHECK(!plan.sums, op, ": what gives one channel must be the last step");
    Step const step = Step(number);
    KV_CHECK(step != Step::contrast || plan.contrast < 0 || ordered, op,
             ": expected one step around a mean at most, or an order that has one");
    if (step == Step::contrast && plan.contrast < 0) plan.contrast = int(plan.steps.size());
    plan.values = plan.values && is_of_values(step);
    plan.sums = is_sum(step);
    plan.parameters += parameters_of(step);
    plan.steps.push_back(step);
  }
  KV_CHECK(int64_t(numbers) == plan.parameters && plan.parameters <= kMostParameters, op, ": expected ",
           plan.parameters, " numbers and at most ", kMostParameters, ", got ", numbers);
  KV_CHECK(columns == 0 || columns == numbers, op, ": expected a column for each of ", numbers, " numbers, got ",
           columns);
  return plan;
}

// `x` itself, or a dense copy: pixels are then one row.
Tensor as_row(Tensor const& x, Layout layout) {
  if (layout == Layout::channels_last)
    return x.stride(0) == x.stride(2) * x.size(2) || x.size(0) == 1 ? x : as_layout(dense(x), layout);
  return dense(x);
}

// --- how its tensors are seen ----------------------------------------------------------------------------------------

// A sample is an image of three channels; or, for steps that treat channels alike, a plane, an image, or everything, as
// the parameters have it.
struct Samples {
  int64_t count, inner, pixels;
  bool of_values, of_planes;

  int channels() const { return of_values ? 1 : 3; }
  Pixels pixels_of(char const* op, Tensor const& x, Layout layout) const {
    auto* const data = const_cast<void*>(x.const_data_ptr());
    bool const last = layout == Layout::channels_last;
    int64_t const c = x.size(1), n = x.size(2) * x.size(3);
    DType const type = dtype_of(op, x);
    if (!of_values) return {data, type, int(c), 1, n * c, 0, last ? 1 : n, last ? c : 1};
    if (!of_planes) return {data, type, 1, 1, pixels, 0, 0, 1};
    return {data, type, 1, inner, n * c, last ? 1 : n, 0, last ? c : 1};
  }
};

// The tensors beside an image, or an error.
struct Arguments {
  Plan plan;
  Maybe order;
  std::vector<Rows> rows;  // of the parameters
  int64_t columns = 0;     // of all of them
  bool by_channel = false;
  bool of_values;
  bool wide;  // computes in double

  Arguments(char const* op, Tensor const& x, Parameters const& given, Maybe const& order, Recipe const& recipe,
            std::vector<double> const& numbers, ScalarType result)
      : plan(plan_of(op, recipe, numbers.size(), bool(order))) {
    check_images(op, "input", x);
    int64_t const b = x.size(0), c = x.size(1);
    of_values = plan.values && (plan.contrast < 0 || c == 1);
    KV_CHECK(of_values || c == 3, op, ": expected input of 3 channels, got ", c);
    wide = x.scalar_type() == ScalarType::Double;
    KV_CHECK(wide == (result == ScalarType::Double), op, ": float64 goes with float64 only");
    for (Maybe const* p : given)
      if (*p) take(op, x, **p);
    size_t at = 0;
    for (Step const step : plan.steps)
      for (int i = 0; i < parameters_of(step) && !recipe.columns.empty(); ++i, ++at) {
        KV_CHECK(recipe.columns[at] < columns, op, ": there are no parameters for the columns that are asked for");
        KV_CHECK(recipe.columns[at] < 0 || takes_tensors(step), op, ": step ", int(step), " takes numbers only");
      }
    if (!order) return;
    KV_CHECK(order->dim() == 2 && (order->size(0) == 1 || order->size(0) == b) && order->size(1) <= kMostSteps, op,
             ": expected order of shape (B, S) with at most ", kMostSteps, " positions");
    KV_CHECK(order->scalar_type() == ScalarType::Long && order->device() == x.device(), op,
             ": expected order of int64, on the device of input");
    KV_CHECK(!plan.sums, op, ": what gives one channel has no order");
    this->order = dense(*order);
  }

  void take(char const* op, Tensor const& x, Tensor const& p) {
    KV_CHECK(p.dim() == 3, op, ": expected parameters of shape (B, C, P), got ", p.dim(), " axes");
    int64_t const images = p.size(0), channels = p.size(1), here = p.size(2);
    KV_CHECK((images == 1 || images == x.size(0)) && (channels == 1 || (channels == x.size(1) && of_values)) &&
                 columns + here <= kMostParameters,
             op, ": parameters of shape (", images, ", ", channels, ", ", here, ") do not fit the images");
    DType const type = dtype_of(op, p);
    KV_CHECK(p.device() == x.device() && type != DType::uint8, op,
             ": expected parameters of floating-point numbers, on the device of input");
    auto const stride = [&](int64_t axis) { return p.size(axis) == 1 ? 0 : p.stride(axis); };
    rows.push_back({p.const_data_ptr(), type, int(columns), stride(0), stride(1), stride(2)});
    columns += here;
    by_channel = by_channel || channels > 1;
  }

  template <class Run>
  void for_computed(Run run) const {
    wide ? run(Type<double>{}) : run(Type<float>{});
  }

  Samples samples(Tensor const& x, bool same_layout) const {
    int64_t const b = x.size(0), c = x.size(1), n = x.size(2) * x.size(3);
    // Of pixels a thread takes three times as much as of values. Rows of other sizes begin where vectors do not.
    bool const pixels = c == 3 && !by_channel && (!same_layout || n % 16 == 0);
    if (!of_values || pixels) return {b, 1, n, false, false};
    if (by_channel || !same_layout) return {b * c, c, n, true, true};
    bool const by_image = plan.contrast >= 0 || !rows.empty() || order;
    return by_image ? Samples{b, 1, c * n, true, false} : Samples{1, 1, b * c * n, true, false};
  }
};

template <class F>
Program<F> program_of(Arguments const& a, Samples const& samples, std::vector<double> const& numbers,
                      std::span<int64_t const> columns) {
  Plan const& plan = a.plan;
  Maybe const& order = a.order;
  Program<F> p{};
  p.samples = samples.count;
  p.pixels = samples.pixels;
  p.inner = samples.inner;
  p.steps = int(plan.steps.size());
  p.count = int(numbers.size());
  p.contrast = plan.contrast;
  p.parts_count = parts_of<F>(p.samples, p.pixels);
  for (int i = 0, at = 0; i < p.steps; at += parameters_of(p.step[i++])) {
    p.step[i] = plan.steps[size_t(i)];
    p.first[i] = at;
  }
  for (int i = 0; i < p.count; ++i) {
    p.numbers[i] = F(numbers[size_t(i)]);
    p.column[i] = columns.empty() ? -1 : int(columns[size_t(i)]);
  }
  p.tensors = int(a.rows.size());
  std::copy(a.rows.begin(), a.rows.end(), p.rows);
  bool const rgb = samples.channels() == 3;
  for (int k = 0; k < 3; ++k) p.grey[k] = F(rgb ? (k == 0 ? 0.299 : k == 1 ? 0.587 : 0.114) : k == 0);
  p.length = p.steps;
  if (order) {
    p.order = static_cast<int64_t const*>(order->const_data_ptr());
    p.order_stride = order->size(0) == 1 ? 0 : order->size(1);
    p.length = int(order->size(1));
  }
  return p;
}

// --- entries ---------------------------------------------------------------------------------------------------------

// The result and the means that it took.
std::tuple<Tensor, Tensor> run(char const* op, Tensor const& input, Parameters const& parameters, Maybe const& order,
                               Recipe const& recipe, std::vector<double> const& numbers) {
  ScalarType const type = recipe.dtype < 0 ? input.scalar_type() : scalar_type_of(DType(recipe.dtype));
  Arguments const a(op, input, parameters, order, recipe, numbers, type);
  Layout const in = layout_of(input);
  Layout const out = recipe.layout < 0 ? in : recipe.layout == 0 ? Layout::planar : Layout::channels_last;
  Tensor const x = as_row(input, in);
  int64_t const channels = a.plan.sums ? 1 : x.size(1);
  Tensor const y = empty({x.size(0), channels, x.size(2), x.size(3)}, x, channels == 1 ? Layout::planar : out, type);
  Samples const samples = a.samples(x, in == out);
  ScalarType const computes = a.wide ? ScalarType::Double : ScalarType::Float;
  bool const around_mean = a.plan.contrast >= 0;
  Tensor const means = around_mean ? empty({samples.count, 1}, x, Layout::planar, computes) : x;
  a.for_computed([&](auto type) {
    using F = typename decltype(type)::type;
    Program<F> p = program_of<F>(a, samples, numbers, recipe.columns);
    p.x = samples.pixels_of(op, x, in);
    p.y = samples.pixels_of(op, y, out);
    [[maybe_unused]] int64_t const cost = 3 * min(kChunk<F>, p.pixels);
    Tensor parts;
    if (around_mean) {
      parts = empty({p.samples, p.parts_count}, means);
      p.parts = static_cast<F*>(parts.mutable_data_ptr());
      p.means = static_cast<F*>(means.mutable_data_ptr());
      p.measures = true;
      KV_RUN(program, x, p, p.samples * p.parts_count, cost);
      p.measures = false;
    }
    KV_RUN(program, x, p, p.samples * chunks_of<F>(p.pixels), cost);
  });
  return {y, means};
}

// Whether parameter i of an affine step is a factor; others shift, or say that nothing is clipped.
bool is_factor(Step step, int i) {
  if (step == Step::affine) return i < 9;
  if (step == Step::line_rgb) return i < 3;
  if (step == Step::standardize_rgb) return i >= 3;
  return step == Step::standardize ? i == 1 : i == 0;
}

// The program that takes the gradient of a linear one's result to that of its image: the steps' transposes in reverse.
struct Transposed {
  std::vector<double> numbers;
  std::vector<int64_t> steps, columns;

  Transposed(Recipe const& recipe, std::vector<double> const& of) {
    size_t end = of.size();
    for (size_t k = recipe.steps.size(); k-- > 0;) {
      Step const step = Step(recipe.steps[k]);
      int const count = parameters_of(step);
      size_t const first = end - size_t(count);
      steps.push_back(recipe.steps[k]);
      for (int i = 0; i < count; ++i) {
        size_t const from = first + size_t(step == Step::affine && i < 9 ? i % 3 * 3 + i / 3 : i);
        bool const scales = is_factor(step, i);
        numbers.push_back(scales ? of[from] : 0);
        if (!recipe.columns.empty()) columns.push_back(scales ? recipe.columns[from] : -1);
      }
      end = first;
    }
  }
};

#define KV_PARAMETERS \
  Maybe const &p0, Maybe const &p1, Maybe const &p2, Maybe const &p3, Maybe const &p4, Maybe const &p5
#define KV_GIVEN {&p0, &p1, &p2, &p3, &p4, &p5}

bool has_mean(Recipe const& recipe) {
  return std::count(recipe.steps.begin(), recipe.steps.end(), int64_t(Step::contrast)) > 0;
}

Tensor color_program(Tensor const& input, KV_PARAMETERS, Maybe const& order, std::vector<int64_t> plan,
                     std::vector<double> numbers) {
  char const* const op = "color_program";
  Recipe const recipe = recipe_of(op, plan);
  KV_CHECK(!has_mean(recipe), op, ": a step around a mean is for color_program_around_mean");
  return std::get<0>(run(op, input, KV_GIVEN, order, recipe, numbers));
}
std::tuple<Tensor, Tensor> color_program_around_mean(Tensor const& input, KV_PARAMETERS, Maybe const& order,
                                                     std::vector<int64_t> plan, std::vector<double> numbers) {
  char const* const op = "color_program_around_mean";
  Recipe const recipe = recipe_of(op, plan);
  KV_CHECK(has_mean(recipe), op, ": there is no step around a mean");
  return run(op, input, KV_GIVEN, order, recipe, numbers);
}

// The gradients of the image and, for each sample of the batch, of the parameters; without elements where they are not
// wanted.
std::tuple<Tensor, Tensor> color_program_backward(Tensor const& grad, Tensor const& input, KV_PARAMETERS,
                                                  Maybe const& order, Maybe const& means, std::vector<int64_t> plan,
                                                  std::vector<double> numbers, bool of_image, bool of_parameters) {
  char const* const op = "color_program_backward";
  Recipe const recipe = recipe_of(op, plan);
  Arguments const a(op, input, KV_GIVEN, order, recipe, numbers, grad.scalar_type());
  bool same = grad.dim() == 4 && grad.size(1) == (a.plan.sums ? 1 : input.size(1)) && grad.device() == input.device();
  for (int64_t i : {0, 2, 3}) same = same && grad.size(i) == input.size(i);
  KV_CHECK(same, op, ": grad differs in shape or device from the result of input");
  KV_CHECK(grad.scalar_type() != ScalarType::Byte && !(of_image && input.scalar_type() == ScalarType::Byte), op,
           ": bytes have no gradient");
  KV_CHECK(!of_parameters || !a.rows.empty(), op, ": there are no parameters that a gradient is wanted of");
  Layout const in = layout_of(input), out = layout_of(grad);
  Tensor const x = as_row(input, in), g = as_row(grad, out);
  Samples const samples = a.samples(x, in == out || grad.size(1) != x.size(1));
  ScalarType const computes = a.wide ? ScalarType::Double : ScalarType::Float;
  bool const around_mean = a.plan.contrast >= 0;
  KV_CHECK(around_mean ? (means && means->dim() == 2 && means->size(0) == samples.count && means->size(1) == 1 &&
                          means->scalar_type() == computes && means->device() == x.device())
                       : !means,
           op, ": expected means as color_program_around_mean gives them");
  int64_t const b = x.size(0);
  bool linear = of_image && !of_parameters && !order && !around_mean && !a.plan.sums && recipe.steps.size() > 0;
  for (size_t i = 0, at = 0; i < a.plan.steps.size(); at += size_t(parameters_of(a.plan.steps[i++])))
    linear = linear && is_affine(a.plan.steps[i], numbers.data() + at);
  if (linear) {
    Transposed const transposed(recipe, numbers);
    Recipe const back{int64_t(dtype_of(op, x)), in == Layout::planar ? 0 : 1, transposed.steps, transposed.columns};
    return {std::get<0>(run(op, grad, KV_GIVEN, {}, back, transposed.numbers)),
            empty({b, 0}, x, Layout::planar, computes)};
  }
  Tensor const grad_x = of_image ? empty_like(x, in) : empty({b, 0}, x);
  int64_t const rows = a.by_channel ? x.size(1) : 1;  // of parameters, of an image
  Tensor const of_rows = of_parameters ? empty({b, rows, a.columns}, x, Layout::planar, computes)
                                       : empty({b, 0}, x, Layout::planar, computes);
  a.for_computed([&](auto type) {
    using F = typename decltype(type)::type;
    ProgramBackward<F> p{};
    p.forward = program_of<F>(a, samples, numbers, recipe.columns);
    p.forward.x = samples.pixels_of(op, x, in);
    p.grad = samples.pixels_of(op, g, out);
    p.wants_x = of_image;
    for (int i = 0; i < p.forward.steps; ++i) {
      p.needs_input[i] = of_parameters || !is_affine(p.forward.step[i], p.forward.numbers + p.forward.first[i]);
      p.reads_x = p.reads_x || p.needs_input[i];
    }
    if (of_image) p.grad_x = samples.pixels_of(op, grad_x, in);
    int64_t const chunks = chunks_of<F>(samples.pixels), shares = shares_of<F>(samples.count, samples.pixels);
    [[maybe_unused]] int64_t const cost = 12 * min(kChunk<F>, samples.pixels);
    Tensor slopes, dense_means, parts;
    if (around_mean) {
      dense_means = dense(*means);
      p.forward.means = static_cast<F*>(const_cast<void*>(dense_means.const_data_ptr()));
      parts = empty({samples.count, p.forward.parts_count}, dense_means);
      p.forward.parts = static_cast<F*>(parts.mutable_data_ptr());
      p.forward.measures = true;
      KV_RUN(program_backward, x, p, samples.count * p.forward.parts_count, cost);
      p.forward.measures = false;
    }
    if (of_parameters) {
      p.columns = int(a.columns);
      slopes = empty({samples.count, shares, p.columns}, of_rows);
      p.slopes = static_cast<F*>(slopes.mutable_data_ptr());
    }
    KV_RUN(program_backward, x, p, samples.count * chunks, cost);
    if (!of_parameters) return;
    ProgramReduce<F> const sums{p.slopes, static_cast<F*>(of_rows.mutable_data_ptr()), b * rows * p.columns,
                                samples.inner / rows * shares, p.columns};
    KV_RUN(program_reduce, x, sums, sums.count, sums.summands);
  });
  return {grad_x, of_rows};
}

}  // namespace

#define KV_PROGRAM "Tensor? p0, Tensor? p1, Tensor? p2, Tensor? p3, Tensor? p4, Tensor? p5, Tensor? order, "
KV_OPERATOR(color_program, "(Tensor input, " KV_PROGRAM "int[] plan, float[] numbers) -> Tensor")
KV_OPERATOR(color_program_around_mean, "(Tensor input, " KV_PROGRAM "int[] plan, float[] numbers) -> (Tensor, Tensor)")
KV_OPERATOR(color_program_backward,
            "(Tensor grad, Tensor input, " KV_PROGRAM
            "Tensor? means, int[] plan, float[] numbers, bool of_image, bool of_parameters) -> (Tensor, Tensor)")

}  // namespace kv
