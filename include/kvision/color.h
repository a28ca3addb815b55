// Colour programs: chains of per-pixel steps, which csrc/color/program.h lists with their parameters; the conversions
// of python/kvision/color are programs of one step. Images are (B, 3, H, W). A second derivative is an error.
#pragma once

#include <vector>

#include "kvision/operator.h"

namespace kvision {

inline Tensor color_program_backward(Tensor const& grad, Tensor const& input, std::vector<int64_t> const& steps,
                                     std::vector<double> const& parameters) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"color_program_backward">(grad, input, steps, parameters)}; };
  return differentiable({grad, input}, compute, {}, no_second_derivative("color_program"))[0];
}

inline Tensor color_program(Tensor const& input, std::vector<int64_t> const& steps,
                            std::vector<double> const& parameters) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"color_program">(input, steps, parameters)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{color_program_backward(b.grads[0], b.saved[0], steps, parameters)};
  };
  return differentiable({input}, compute, {input}, gradient)[0];
}

}  // namespace kvision
