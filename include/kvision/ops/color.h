// Color programs, mosaics and chroma. Arguments are those of torch.ops.kvision.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

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

}  // namespace detail

inline constexpr Operator<"color_program", Tensor(Tensor input, OptionalTensor p0, OptionalTensor p1, OptionalTensor p2,
                                                  OptionalTensor p3, OptionalTensor p4, OptionalTensor p5,
                                                  OptionalTensor order, Ints plan, Floats numbers)>
    color_program{detail::color_gradients};
inline constexpr Operator<"color_program_around_mean",
                          Two(Tensor input, OptionalTensor p0, OptionalTensor p1, OptionalTensor p2, OptionalTensor p3,
                              OptionalTensor p4, OptionalTensor p5, OptionalTensor order, Ints plan, Floats numbers)>
    color_program_around_mean{detail::color_gradients, 1};

inline constexpr Operator<"raw_to_rgb", Tensor(Tensor input, int64_t cfa)> raw_to_rgb{linear};
inline constexpr Operator<"split_chroma", Two(Tensor input, int64_t rows, Floats matrix)> split_chroma{detail::chroma};
inline constexpr Operator<"join_chroma", Tensor(Tensor luma, Tensor chroma, int64_t rows, Floats matrix)> join_chroma{
    detail::chroma};
inline constexpr Operator<"apply_colormap", Tensor(Tensor input, Tensor white, Tensor colors)> apply_colormap{
    non_differentiable};

}  // namespace kvision::ops
