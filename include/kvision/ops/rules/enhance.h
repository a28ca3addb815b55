// Gradients of blends and codecs that are no single call.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops::detail::rules {

inline constexpr Rule add_weighted{[](Backward const& b) -> variable_list {
  Tensor const &g = b.grad(), x = b.tensor(0), y = b.tensor(1);
  auto const scaled = [&](size_t weights, size_t number) {
    Tensor const w = b.tensor(weights);
    return w.defined() ? (g * w.unsqueeze(3)).to(g.scalar_type()) : g * b.arguments[number].toDouble();
  };
  auto const summed = [&](size_t i, auto const& pixels) { return b.needs(i) ? pixels().sum(3) : Tensor(); };
  return {scaled(2, 5), scaled(3, 6), summed(2, [&] { return g * x; }), summed(3, [&] { return g * y; }),
          summed(4, [&] { return g; })};
}};
inline constexpr Rule jpeg{[](Backward const& b) -> variable_list {
  bool const of_steps = b.needs(1) || b.needs(2) || b.needs(3);
  variable_list gradients = b.call("jpeg_backward", {{"of_image", b.needs(0)}, {"of_steps", of_steps}});
  gradients[1] = gradients[1].flatten();
  return gradients;
}};

}  // namespace kvision::ops::detail::rules
