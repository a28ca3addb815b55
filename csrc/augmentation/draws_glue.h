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

}  // namespace kv::augmentation
