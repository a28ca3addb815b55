// Color programs: schemas and entries, for CPU and CUDA.
#include "program_glue.h"

namespace kv::color {
namespace {

#define KV_PARAMETERS                                                                                     \
  OptionalTensor const &p0, OptionalTensor const &p1, OptionalTensor const &p2, OptionalTensor const &p3, \
      OptionalTensor const &p4, OptionalTensor const &p5
#define KV_PARAMETER_NAMES p0, p1, p2, p3, p4, p5
#define KV_PARAMETER_LIST {&p0, &p1, &p2, &p3, &p4, &p5}

ProgramArguments arguments_of(char const* op, Tensor const& x, std::initializer_list<OptionalTensor const*> parameters,
                              OptionalTensor const& order, PlanArgument const& plan, std::vector<double> const& numbers,
                              ScalarType result) {
  ProgramArguments a(op, x, plan, numbers, result, order.has_value());
  for (OptionalTensor const* p : parameters)
    if (*p) a.add_tensor(op, x, **p);
  a.check_columns(op, plan);
  if (order) a.set_order(op, x, *order);
  return a;
}

std::tuple<Tensor, Tensor> run(char const* op, Tensor const& input, KV_PARAMETERS, OptionalTensor const& order,
                               PlanArgument const& plan, std::vector<double> const& numbers) {
  ScalarType const type = result_type(plan, input);
  return run_program(op, input, arguments_of(op, input, KV_PARAMETER_LIST, order, plan, numbers, type), plan, numbers);
}

bool has_mean(PlanArgument const& plan) {
  return std::count(plan.steps.begin(), plan.steps.end(), int64_t(Step::contrast)) > 0;
}

Tensor color_program(Tensor const& input, KV_PARAMETERS, OptionalTensor const& order, std::vector<int64_t> plan,
                     std::vector<double> numbers) {
  char const* const op = "color_program";
  PlanArgument const parsed = parse_plan(op, plan);
  KV_CHECK(!has_mean(parsed), op, ": a step around a mean is for color_program_around_mean");
  return std::get<0>(run(op, input, KV_PARAMETER_NAMES, order, parsed, numbers));
}
std::tuple<Tensor, Tensor> color_program_around_mean(Tensor const& input, KV_PARAMETERS, OptionalTensor const& order,
                                                     std::vector<int64_t> plan, std::vector<double> numbers) {
  char const* const op = "color_program_around_mean";
  PlanArgument const parsed = parse_plan(op, plan);
  KV_CHECK(has_mean(parsed), op, ": there is no step around a mean");
  return run(op, input, KV_PARAMETER_NAMES, order, parsed, numbers);
}

// The gradients of the image and, for each image of the batch, of the parameters. A gradient that is not requested has
// no elements.
std::tuple<Tensor, Tensor> color_program_backward(Tensor const& grad, Tensor const& input, KV_PARAMETERS,
                                                  OptionalTensor const& order, OptionalTensor const& means,
                                                  std::vector<int64_t> plan, std::vector<double> numbers, bool of_image,
                                                  bool of_parameters) {
  char const* const op = "color_program_backward";
  PlanArgument const parsed = parse_plan(op, plan);
  ProgramArguments const a = arguments_of(op, input, KV_PARAMETER_LIST, order, parsed, numbers, grad.scalar_type());
  return program_gradients(op, grad, input, a, parsed, numbers, means, {of_image, of_parameters});
}

}  // namespace

#define KV_PROGRAM "Tensor? p0, Tensor? p1, Tensor? p2, Tensor? p3, Tensor? p4, Tensor? p5, Tensor? order, "
KV_OPERATOR(color_program, "(Tensor input, " KV_PROGRAM "int[] plan, float[] numbers) -> Tensor")
KV_OPERATOR(color_program_around_mean, "(Tensor input, " KV_PROGRAM "int[] plan, float[] numbers) -> (Tensor, Tensor)")
KV_OPERATOR(color_program_backward,
            "(Tensor grad, Tensor input, " KV_PROGRAM
            "Tensor? means, int[] plan, float[] numbers, bool of_image, bool of_parameters) -> (Tensor, Tensor)")

}  // namespace kv::color
