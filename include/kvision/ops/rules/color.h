// Gradients of color programs and chroma that are no single call.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops::detail::rules {

inline constexpr auto color_gradients = [](Backward const& b) -> variable_list {
  c10::IValue const means = b.results.empty() ? c10::IValue() : c10::IValue(b.results[0]);
  bool needs_parameters = false;
  for (size_t i = 1; i <= 6; ++i) needs_parameters = needs_parameters || b.needs(i);
  auto const grads = b.call("color_program_backward",
                            {{"means", means}, {"of_image", b.needs(0)}, {"of_parameters", needs_parameters}});
  variable_list gradients{grads[0]};
  int64_t first = 0;
  for (size_t i = 1; i <= 6; ++i) {
    int64_t const columns = b.tensor(i).defined() ? b.tensor(i).size(2) : 0;
    gradients.push_back(b.needs(i) ? grads[1].narrow(2, first, columns) : Tensor());
    first += columns;
  }
  return gradients;
};

// Each is the other with the transposed matrix.
inline constexpr Rule chroma{
    [](Backward const& b) -> variable_list {
      bool const splits = name_of(b.op) == "split_chroma";
      auto const m = b.arguments[splits ? 2 : 3].toDoubleVector();
      Floats const transposed{m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]};
      if (!splits) return b.call("split_chroma", {{"input", b.grad()}, {"matrix", transposed}}, chroma);
      return b.call("join_chroma", {{"luma", b.grads[0]}, {"chroma", b.grads[1]}, {"matrix", transposed}}, chroma);
    },
    0, false};

inline constexpr Rule color_program{color_gradients};
inline constexpr Rule color_program_around_mean{color_gradients, 1};

inline constexpr Rule split_chroma{chroma};
inline constexpr Rule join_chroma{chroma};
inline constexpr Rule apply_colormap = non_differentiable;

}  // namespace kvision::ops::detail::rules
