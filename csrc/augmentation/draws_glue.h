// Random parameters for the entries of operators. Included by draws_op.cpp and draw_warp_and_color_op.cpp.
#pragma once

#include <span>

#include "augmentation/draws.h"
#include "glue/glue.h"

namespace kv::augmentation {

// The draws of a plan, as make_plan in draws.py writes it, without the memory of their result.
DrawParameters<float> draws_of(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                               std::span<int64_t const> plan, std::span<double const> numbers);

// Memory for their result, (B, columns).
inline Tensor columns_for(DrawParameters<float>& p, Tensor const& images) {
  Tensor const result = empty({p.batch, p.columns}, images, Layout::planar, ScalarType::Float);
  p.result = data_ptr<float>(result);
  return result;
}

}  // namespace kv::augmentation
