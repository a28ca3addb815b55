// Random parameters for the entries of operators.
#pragma once

#include <algorithm>
#include <span>

#include "augmentation/draws.h"
#include "glue/views.h"

namespace kv::augmentation {

// The parameters of the kernel for a plan that make_plan in draws.py has written; `result` is not set. Errors name
// `op`.
DrawParameters<float> draws_of(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                               std::span<int64_t const> plan, std::span<double const> numbers,
                               char const* op = "draw_parameters");

// Allocates the result (B, columns) of the draws, and sets it in `p`.
inline Tensor columns_for(DrawParameters<float>& p, Tensor const& images) {
  Tensor const result = empty({p.batch, p.columns}, images, Layout::planar, ScalarType::Float);
  p.result = data_ptr<float>(result);
  return result;
}

// Lets some draws read numbers of each sample, and returns how many these are.
inline size_t list_draws(char const* op, DrawParameters<float>& p, std::span<int64_t const> draws) {
  size_t width = 0;
  for (int64_t const i : draws) {
    KV_CHECK(i >= 0 && i < p.count, op, ": there is no draw ", i, " to list numbers of");
    p.draws[i].number = uint16_t(kMaxDrawNumbers + width);
    width += size_t(kDrawNumbers[int(p.draws[i].kind)]);
  }
  KV_CHECK(width <= kMaxListedNumbers, op, ": expected at most ", kMaxListedNumbers, " numbers of a sample, got ",
           width);
  return width;
}

// The same with these numbers (B, width) of all samples.
inline size_t list_draws(char const* op, DrawParameters<float>& p, std::span<int64_t const> draws,
                         std::span<double const> listed) {
  DrawParameters<float> const before = p;
  size_t const width = list_draws(op, p, draws);
  KV_CHECK(listed.size() == size_t(p.batch) * width, op, ": expected ", width, " numbers for each of ", p.batch,
           " images, got ", listed.size(), " in all");
  for (int64_t const i : draws)  // the columns of a draw are the same for all samples
    for (size_t at = p.draws[i].number - size_t(kMaxDrawNumbers); at < listed.size(); at += width) {
      if (kDrawColumns[int(p.draws[i].kind)]) break;
      double const columns = before.numbers[before.draws[i].number];
      KV_CHECK(listed[at] == columns, op, ": expected draws of ", columns, " columns, got ", listed[at]);
    }
  return width;
}

// Calls run() for as many samples at a time as have room for their numbers.
template <int Most, class Run>
void for_each_listed(DrawListParameters<float, Most>& p, std::span<double const> listed, size_t width, Run run) {
  size_t const batch = size_t(p.all.batch), most = width ? Most / width : batch;
  p.width = int(width);
  for (size_t begin = 0; begin < batch; begin += most) {
    size_t const count = std::min(most, batch - begin);
    p.begin = int64_t(begin);
    p.count = int(count);
    std::copy_n(listed.begin() + int64_t(begin * width), count * width, p.listed);
    run();
  }
}

}  // namespace kv::augmentation
