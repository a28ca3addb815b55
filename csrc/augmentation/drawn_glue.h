// Operators that draw parameters and use them at once: their plans, and the draws with the first chain of transforms
// that reads them. Included by draw_warp_and_color_op.cpp and draw_links_op.cpp.
#pragma once

#include "augmentation/draw_warp_and_color.h"
#include "augmentation/draws_glue.h"
#include "augmentation/transforms_glue.h"

namespace kv::augmentation {

// The plan of a chain of transforms, and its numbers.
struct ChainPlan {
  std::span<int64_t const> plan;
  std::span<double const> numbers;
};

// Several plans one after the other, and their numbers. They are tensors because torch converts the entries of lists
// one by one.
class PackedPlan {
  char const* op_;
  std::span<int64_t const> plan_;
  std::span<double const> numbers_;

  template <class T>
  std::span<T const> span_of(Tensor const& x, ScalarType type) const {
    KV_CHECK(x.is_cpu() && x.dim() == 1 && x.scalar_type() == type && x.is_contiguous(), op_,
             ": expected plans of one axis on the CPU, int64 and float64");
    return {data_ptr<T const>(x), size_t(x.numel())};
  }

 public:
  PackedPlan(char const* op, Tensor const& plan, Tensor const& numbers)
      : op_(op),
        plan_(span_of<int64_t>(plan, ScalarType::Long)),
        numbers_(span_of<double>(numbers, ScalarType::Double)) {}

  // What is left.
  std::span<int64_t const> plan() const { return plan_; }
  std::span<double const> numbers() const { return numbers_; }

  std::span<int64_t const> next(int64_t count) {
    KV_CHECK(count >= 0 && size_t(count) <= plan_.size(), op_, ": the plan ends early");
    auto const part = plan_.first(size_t(count));
    plan_ = plan_.subspan(size_t(count));
    return part;
  }
  int64_t next() { return next(1)[0]; }
  std::span<int64_t const> next_list() { return next(next()); }  // which begins with its length
  std::span<double const> next_numbers(int64_t count) {
    KV_CHECK(count >= 0 && size_t(count) <= numbers_.size(), op_, ": expected at least ", count, " numbers, got ",
             numbers_.size());
    auto const part = numbers_.first(size_t(count));
    numbers_ = numbers_.subspan(size_t(count));
    return part;
  }
  ChainPlan next_chain() {
    auto const chain = next_list();
    return {chain, next_numbers(int64_t(count_inputs(op_, chain)))};
  }
};

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
    DrawsAndChain p{draws, transform_params<float>(op, columns, chain.plan, chain.numbers)};
    p.chain.result = data_ptr<float>(matrix);
    KV_RUN(draw_and_multiply, image, p, batch, 0);
    return {columns, matrix};
  }
#endif
  Tensor const columns = columns_for(draws, image);
  KV_RUN(draw_parameters, image, draws, draws.count ? draws.batch : 0, 64 * draws.count);
  return {columns, {}};
}

}  // namespace kv::augmentation
