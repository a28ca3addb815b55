// Random parameters for the entries of operators. Included by draws_op.cpp and draw_warp_and_color_op.cpp.
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

// How many draws the first request has.
inline int draws_of_first(DrawParameters<float> const& p) {
  int end = 0;
  while (end < p.count && p.draws[end].probability == 0) ++end;
  return end;
}

// Raises unless `listed` has `width` numbers of each sample, those of whole draws of the first request.
inline void check_listed(char const* op, DrawParameters<float> const& p, std::span<double const> listed, size_t batch,
                         size_t width) {
  size_t own = 0;
  int const end = draws_of_first(p);
  for (int i = 0; i < end; ++i) own += size_t(kDrawNumbers[int(p.draws[i].kind)]);
  KV_CHECK(listed.size() == batch * width && (!batch || width == own) && width <= kMaxListedNumbers, op, ": expected ",
           own, " numbers for each of ", batch, " images, got ", listed.size(), " in all");
  for (int i = 0; i < end; ++i)
    for (size_t b = 0; !kDrawColumns[int(p.draws[i].kind)] && b < batch; ++b) {
      double const own_entries = listed[b * width + p.draws[i].number - kFirstListed];
      KV_CHECK(own_entries == p.numbers[p.draws[i].number], op, ": expected draws of ", p.numbers[p.draws[i].number],
               " columns, got ", own_entries);
    }
}

// Calls run() for as many samples at a time as have room for their numbers.
template <class Run>
void for_each_listed(DrawListParameters<float>& p, std::span<double const> listed, size_t width, Run run) {
  size_t const batch = size_t(p.all.batch), most = width ? kMaxListedNumbers / width : batch;
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
