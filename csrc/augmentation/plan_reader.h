// Reads the plans of operators that run several things: integers, in which lists begin with their lengths, and numbers.
#pragma once

#include "augmentation/transforms_glue.h"

namespace kv::augmentation {

// The plan of a chain of transforms, and its numbers.
struct ChainPlan {
  std::span<int64_t const> plan;
  std::span<double const> numbers;
};

class PlanReader {
  char const* op_;
  std::span<int64_t const> plan_;
  std::span<double const> numbers_;

 public:
  PlanReader(char const* op, std::span<int64_t const> plan, std::span<double const> numbers)
      : op_(op), plan_(plan), numbers_(numbers) {}

  // What is left.
  std::span<int64_t const> plan() const { return plan_; }
  std::span<double const> numbers() const { return numbers_; }

  std::span<int64_t const> next(size_t count) {
    KV_CHECK(count <= plan_.size(), op_, ": the plan ends early");
    auto const part = plan_.first(count);
    plan_ = plan_.subspan(count);
    return part;
  }
  int64_t next() { return next(1)[0]; }
  // How many integers or numbers follow.
  size_t next_count() {
    int64_t const count = next();
    KV_CHECK(count >= 0, op_, ": expected a number of integers, got ", count);
    return size_t(count);
  }
  std::span<int64_t const> next_list() { return next(next_count()); }
  std::span<double const> next_numbers(size_t count) {
    KV_CHECK(count <= numbers_.size(), op_, ": expected at least ", count, " numbers, got ", numbers_.size());
    auto const part = numbers_.first(count);
    numbers_ = numbers_.subspan(count);
    return part;
  }
  ChainPlan next_chain() {
    auto const chain = next_list();
    return {chain, next_numbers(count_inputs(op_, chain))};
  }
};

}  // namespace kv::augmentation
