// Color programs whose parameters are numbers. The fewer arguments take the host less time: a call of color_program,
// with optional tensors and a plan that is a list, takes 1.5 times as long.
#include "program_glue.h"

namespace kv::color {
namespace {

Tensor color_program_of_numbers(Tensor const& input, Tensor const& plan, std::vector<double> const& numbers) {
  char const* const op = "color_program_of_numbers";
  KV_CHECK(plan.is_cpu() && plan.dim() == 1 && plan.scalar_type() == ScalarType::Long && plan.is_contiguous(), op,
           ": expected a plan of one axis, int64 on the CPU");
  int64_t const* const entries = data_ptr<int64_t const>(plan);
  std::vector<int64_t> const entries_of_plan(entries, entries + plan.numel());
  PlanArgument const parsed = parse_plan(op, entries_of_plan);
  ProgramArguments a(op, input, parsed, numbers, result_type(parsed, input), false);
  a.check_columns(op, parsed);
  return std::get<0>(run_program(op, input, a, parsed, numbers));
}

}  // namespace

KV_OPERATOR(color_program_of_numbers, "(Tensor input, Tensor plan, float[] numbers) -> Tensor")

}  // namespace kv::color
