// Colour programs: chains of per-pixel steps, which csrc/color/program.h lists with their parameters; the conversions
// of python/kvision/color and the adjustments of python/kvision/enhance are programs of one step. A second derivative
// is an error.
#pragma once

#include <tuple>
#include <vector>

#include "kvision/operator.h"

namespace kvision {

// The steps and all their parameters as `numbers`. A parameter that is a tensor has its column of `parameters`, (B or
// 1, C or 1, P) of float, or double for double images, in `columns`, and the others have -1 there. `order` (B or 1, S)
// of int64 has the step of each position, or -1 for none. The result has the dtype, as torch names it, and the layout,
// "NCHW" or "NHWC", that are asked for; bytes are 255ths.
struct ColorProgram {
  std::vector<int64_t> steps;
  std::vector<double> numbers;
  std::optional<Tensor> parameters = {};
  std::vector<int64_t> columns = {};
  std::optional<Tensor> order = {};
  std::string dtype = "same", layout = "same";
};

// The gradients of the image and of the parameters, the latter for each sample; without elements where not wanted.
inline std::tuple<Tensor, Tensor> color_program_backward(Tensor const& grad, Tensor const& input, ColorProgram const& p,
                                                         std::optional<Tensor> const& mean, bool of_image,
                                                         bool of_parameters) {
  using namespace detail;
  auto const compute = [&] {
    auto const [of_x, of_rows] = call<"color_program_backward", std::tuple<Tensor, Tensor>>(
        grad, input, p.parameters, p.order, mean, p.steps, p.numbers, p.columns, of_image, of_parameters);
    return variable_list{of_x, of_rows};
  };
  auto const found = differentiable({grad, input, p.parameters.value_or(Tensor())}, compute, {},
                                    no_second_derivative("color_program"));
  return {found[0], found[1]};
}

namespace detail {

inline variable_list color_gradients(Backward const& b, ColorProgram const& p, std::optional<Tensor> const& mean) {
  bool const of_parameters = p.parameters && b.wanted(1);
  auto const [of_x, of_rows] = color_program_backward(b.grads[0], b.saved[0], p, mean, b.wanted(0), of_parameters);
  bool const shared = of_parameters && p.parameters->size(0) == 1;
  return {b.wanted(0) ? of_x : Tensor(), !of_parameters ? Tensor() : shared ? of_rows.sum({0}, true) : of_rows};
}

}  // namespace detail

inline Tensor color_program(Tensor const& input, ColorProgram const& p) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"color_program">(input, p.parameters, p.order, p.steps, p.numbers, p.columns, p.dtype, p.layout)};
  };
  auto const gradient = [=](Backward const& b) { return color_gradients(b, p, {}); };
  return differentiable({input, p.parameters.value_or(Tensor())}, compute, {input}, gradient)[0];
}

// With a step `contrast`, and the mean of each sample around which there was contrast as the second result.
inline std::tuple<Tensor, Tensor> color_program_around_mean(Tensor const& input, ColorProgram const& p) {
  using namespace detail;
  Tensor mean;
  auto const compute = [&] {
    auto const [y, found] = call<"color_program_around_mean", std::tuple<Tensor, Tensor>>(
        input, p.parameters, p.order, p.steps, p.numbers, p.columns, p.dtype, p.layout);
    mean = found;
    return variable_list{y};
  };
  // The mean is there only when the gradient is: it is kept by reference until then.
  auto const kept = std::make_shared<Tensor>();
  auto const gradient = [=](Backward const& b) { return color_gradients(b, p, *kept); };
  Tensor const y = differentiable({input, p.parameters.value_or(Tensor())}, compute, {input}, gradient)[0];
  *kept = mean;
  return {y, mean};
}

}  // namespace kvision
