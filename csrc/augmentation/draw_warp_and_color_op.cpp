// Random parameters and the pass over images that reads them, as one operator. Two operators would cost the host twice:
// most of the time of a call on a small image is spent in torch's dispatcher.
#include "augmentation/draw_warp_and_color.h"
#include "augmentation/draws_glue.h"
#include "augmentation/transforms_glue.h"
#include "augmentation/warp_and_color_glue.h"

namespace kv::augmentation {
namespace {

constexpr char const* kOperator = "draw_warp_and_color";

template <class T>
std::span<T const> numbers_of(Tensor const& x, ScalarType type) {
  KV_CHECK(x.is_cpu() && x.dim() == 1 && x.scalar_type() == type && x.is_contiguous(), kOperator,
           ": expected plans of one axis on the CPU, int64 and float64");
  return {data_ptr<T const>(x), size_t(x.numel())};
}

struct Drawn {
  Tensor columns;
  std::optional<Tensor> matrix;  // without one, run_pass computes it from the columns
};

// Draws the columns. On CUDA the same launch computes the matrices of the pass, whose chain begins its plan.
Drawn draw(Tensor const& image, DrawParameters<float>& draws, [[maybe_unused]] bool warps,
           [[maybe_unused]] std::span<int64_t const> plan, [[maybe_unused]] std::span<double const> numbers) {
#if defined(KV_CUDA)
  if (warps) {
    KV_CHECK(plan.size() > 5 && plan[5] >= 0 && size_t(plan[5]) <= plan.size() - 6, kOperator, ": the plan ends early");
    auto const chain = plan.subspan(6, size_t(plan[5]));
    size_t const count = count_inputs(kOperator, chain);
    KV_CHECK(count <= numbers.size(), kOperator, ": expected at least ", count, " numbers, got ", numbers.size());
    int64_t const batch = draws.batch, elements = batch * draws.columns;
    Tensor const memory = empty({elements + 9 * batch}, image, Layout::planar, ScalarType::Float);
    Tensor const columns = view_of(memory, {batch, draws.columns}, 0),
                 matrix = view_of(memory, {batch, 3, 3}, elements);
    draws.result = data_ptr<float>(columns);
    DrawsAndChain p{draws, transform_params<float>(kOperator, columns, chain, numbers.first(count))};
    p.chain.result = data_ptr<float>(matrix);
    KV_RUN(draw_and_multiply, image, p, batch, 0);
    return {columns, matrix};
  }
#endif
  Tensor const columns = columns_for(draws, image);
  KV_RUN(draw_parameters, image, draws, draws.count ? draws.batch : 0, 64 * draws.count);
  return {columns, {}};
}

// The plan is written by DrawnPass in drawn_pass.py: the length of the plan of the draws, and that plan; how many of
// the numbers belong to the draws; the length of the size of the result, and that size; the plan of the pass. Returns
// the result, the matrices of the warp, and the columns; without a warp the columns also stand for the matrices.
std::tuple<Tensor, Tensor, Tensor> draw_warp_and_color(Tensor const& image, Tensor const& keys,
                                                       std::optional<Tensor> const& seeds, Tensor const& plan,
                                                       Tensor const& numbers) {
  auto rest = numbers_of<int64_t>(plan, ScalarType::Long);
  auto const all_numbers = numbers_of<double>(numbers, ScalarType::Double);
  auto const next = [&](int64_t count) {
    KV_CHECK(count >= 0 && size_t(count) <= rest.size(), kOperator, ": the plan ends early");
    auto const part = rest.first(size_t(count));
    rest = rest.subspan(size_t(count));
    return part;
  };
  auto const draws = next(next(1)[0]), count = next(1), size = next(next(1)[0]);
  KV_CHECK(count[0] >= 0 && size_t(count[0]) <= all_numbers.size(), kOperator, ": expected at least ", count[0],
           " numbers, got ", all_numbers.size());
  auto const of_draws = all_numbers.first(size_t(count[0])), of_pass = all_numbers.subspan(size_t(count[0]));
  auto params = draws_of(image, keys, seeds, draws, of_draws);
  auto const [columns, drawn_matrix] = draw(image, params, !size.empty(), rest, of_pass);
  auto const [y, matrix, means] = run_pass(image, columns, {}, drawn_matrix, {size.begin(), size.end()},
                                           {rest.begin(), rest.end()}, {of_pass.begin(), of_pass.end()});
  return {y, matrix ? *matrix : columns, columns};
}

}  // namespace

KV_OPERATOR(draw_warp_and_color,
            "(Tensor image, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::augmentation
