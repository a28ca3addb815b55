// Operators that draw parameters and use them at once: their plans, and the draws with the first chain of transforms
// that reads them.
#pragma once

#include "augmentation/draw_warp_and_color.h"
#include "augmentation/draws_glue.h"
#include "augmentation/plan_reader.h"

namespace kv::augmentation {

// Plans one after the other, and their numbers. They are tensors because torch converts the entries of lists one by
// one.
inline PlanReader read_plan(char const* op, Tensor const& plan, Tensor const& numbers) {
  auto const check = [&](Tensor const& x, ScalarType type) {
    KV_CHECK(x.is_cpu() && x.dim() == 1 && x.scalar_type() == type && x.is_contiguous(), op,
             ": expected plans of one axis on the CPU, int64 and float64");
  };
  check(plan, ScalarType::Long), check(numbers, ScalarType::Double);
  return {op,
          {data_ptr<int64_t const>(plan), size_t(plan.numel())},
          {data_ptr<double const>(numbers), size_t(numbers.numel())}};
}

struct Drawn {
  Tensor columns;
  std::optional<Tensor> matrix;  // (B, 3, 3) of the chain
};

// Draws the columns. On CUDA the same launch computes the matrices of a chain that reads them, unless it is empty.
inline Drawn draw_columns([[maybe_unused]] char const* op, Tensor const& image, DrawParameters<float>& draws,
                          [[maybe_unused]] ChainPlan const& chain) {
#if defined(KV_CUDA)
  if (!chain.plan.empty()) {
    int64_t const batch = draws.batch, elements = batch * draws.columns;
    Tensor const memory = empty({elements + 9 * batch}, image, Layout::planar, ScalarType::Float);
    Tensor const columns = view_of(memory, {batch, draws.columns}, 0),
                 matrix = view_of(memory, {batch, 3, 3}, elements);
    draws.result = data_ptr<float>(columns);
    DrawsAndChain<DrawParameters<float>> p{draws, transform_params<float>(op, columns, chain.plan, chain.numbers)};
    p.chain.result = data_ptr<float>(matrix);
    KV_RUN(draw_and_multiply, image, p, batch, 0);
    return {columns, matrix};
  }
#endif
  Tensor const columns = columns_for(draws, image);
  KV_RUN(draw_parameters, image, draws, draws.count ? draws.batch : 0, 64 * draws.count);
  return {columns, {}};
}

// The same for images of different sizes, of which listed draws have `width` numbers each, by tables of `Most` numbers.
template <int Most>
Drawn draw_by_tables([[maybe_unused]] char const* op, Tensor const& images, DrawParameters<float> const& draws,
                     std::span<double const> listed, size_t width, [[maybe_unused]] ChainPlan const& chain) {
  int64_t const batch = draws.batch, elements = batch * draws.columns;
  Tensor const memory = empty({elements + 9 * batch}, images, Layout::planar, ScalarType::Float);
  Tensor const columns = view_of(memory, {batch, draws.columns}, 0);
#if defined(KV_CUDA)
  if (!chain.plan.empty()) {
    Tensor const matrix = view_of(memory, {batch, 3, 3}, elements);
    DrawsAndChain<DrawListParameters<float, Most>> p;
    p.chain = transform_params<float>(op, columns, chain.plan, chain.numbers);
    p.chain.result = data_ptr<float>(matrix);
    p.draws.all = draws;
    p.draws.all.result = data_ptr<float>(columns);
    for_each_listed(p.draws, listed, width, [&] { KV_RUN(draw_and_multiply, images, p, p.draws.count, 0); });
    return {columns, matrix};
  }
#endif
  DrawListParameters<float, Most> p;
  p.all = draws;
  p.all.result = data_ptr<float>(columns);
  for_each_listed(p, listed, width, [&] { KV_RUN(draw_list_parameters, images, p, p.count, 64 * p.all.count); });
  return {columns, {}};
}
inline Drawn draw_list_columns(char const* op, Tensor const& images, DrawParameters<float>& draws,
                               std::span<double const> listed, size_t width, ChainPlan const& chain) {
  if (width == 0) return draw_columns(op, images, draws, chain);
#if defined(KV_CUDA)
  if (listed.size() <= kFewListedNumbers)
    return draw_by_tables<kFewListedNumbers>(op, images, draws, listed, width, chain);
#endif
  return draw_by_tables<kMaxListedNumbers>(op, images, draws, listed, width, chain);
}

}  // namespace kv::augmentation
