// Random parameters and the pass over images that reads them, as one operator. Two operators would cost the host twice:
// most of the time of a call on a small image is spent in torch's dispatcher.
#include "augmentation/drawn_glue.h"
#include "augmentation/warp_and_color_glue.h"

namespace kv::augmentation {
namespace {

// The plan is written by DrawnPass in drawn_pass.py: the length of the plan of the draws, and that plan; how many of
// the numbers belong to the draws; the length of the size of the result, and that size; the plan of the pass. Returns
// the result, the matrices of the warp, and the columns; without a warp the columns also stand for the matrices.
std::tuple<Tensor, Tensor, Tensor> draw_warp_and_color(Tensor const& image, Tensor const& keys,
                                                       std::optional<Tensor> const& seeds, Tensor const& plan,
                                                       Tensor const& numbers) {
  constexpr char const* op = "draw_warp_and_color";
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto params = draws_of(image, keys, seeds, draws, rest.next_numbers(rest.next_count()));
  auto const size = rest.next_list();
  ChainPlan chain;
  if (!size.empty()) {
    PlanReader of_pass = rest;
    of_pass.next(kPassOptions);
    chain = of_pass.next_chain();
  }
  auto const [columns, drawn_matrix] = draw_columns(op, image, params, chain);
  auto const of_pass = rest.plan();
  auto const pass_numbers = rest.numbers();
  auto const [y, matrix, means] =
      run_pass(image, columns, {}, drawn_matrix, {size.begin(), size.end()}, {of_pass.begin(), of_pass.end()},
               {pass_numbers.begin(), pass_numbers.end()});
  return {y, matrix ? *matrix : columns, columns};
}

}  // namespace

KV_OPERATOR(draw_warp_and_color,
            "(Tensor image, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::augmentation
