// Gradients of noise, erased rectangles and passes over images that are no single call.
#pragma once

#include <ATen/ExpandUtils.h>
#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops::detail::rules {

// The mean and the scale have the sums of the gradient and of its product with the noise alone.
template <Name op>
inline constexpr auto noise_gradients = [](Backward const& b) -> variable_list {
  Ints const plan = b.arguments[5].toIntVector();
  TORCH_CHECK_NOT_IMPLEMENTED(plan.size() < 5 || !(plan[4] & 3), op.text,
                              ": C++ has no gradient of factors and of clamped noise; Python's kvision has");
  if (!b.needs(1)) return {b.grad()};
  Tensor const parameters = b.tensor(1), grad = b.grad().to(parameters.scalar_type());
  Tensor const standard = at::stack({at::zeros({1}, parameters.options()), at::ones({1}, parameters.options())}, 1);
  Tensor const noise = b.call(op.text, {{"images", at::zeros_like(grad)}, {"parameters", standard}})[0];
  OptionalTensor const chosen = b.optional(4);
  Tensor const kept = chosen ? grad * (*chosen != 0).view({-1, 1, 1, 1}) : grad;
  Tensor const to_each = at::stack({kept.sum({1, 2, 3}), (grad * noise).sum({1, 2, 3})}, 1);
  return {b.grad(), at::sum_to(to_each, parameters.sizes())};
};

inline variable_list erased_gradients(Backward const& b, char const* op) {
  Tensor const values = b.tensor(2), kept = b.call(op, {{"images", b.grad()}, {"values", at::zeros_like(values)}})[0];
  if (!b.needs(2)) return {kept};
  return {kept, Tensor(), at::sum_to((b.grad() - kept).to(values.scalar_type()).sum({2, 3}), values.sizes())};
}

// The columns have gradients from the steps that read them and from the matrices that are made of them.
inline constexpr auto warp_and_color_gradients = [](Backward const& b) -> variable_list {
  TORCH_CHECK_NOT_IMPLEMENTED(!b.needs(2), "warp_and_color: C++ has no gradient of fill; Python's kvision has");
  auto const grads = b.call("warp_and_color_backward", {{"of_image", b.needs(0)}, {"of_columns", b.needs(1)}});
  Tensor const of_image = b.needs(0) ? grads[0] : Tensor();
  if (!b.needs(1)) return {of_image, Tensor(), Tensor()};
  Tensor const columns = b.tensor(1);
  Tensor of_columns = grads[1].size(1) > 0 ? grads[1] : at::zeros_like(columns);
  if (!b.arguments[3].toIntVector().empty()) {
    Ints const plan = b.arguments[4].toIntVector();
    Floats const numbers = b.arguments[5].toDoubleVector();
    constexpr size_t options = 6;  // of the pass, before the length of the chain and the chain
    auto const first = plan.begin() + options + 1;
    Ints const chain(first, first + plan[options]);
    constexpr int64_t inputs[] = {9, 16, 7, 9};  // of the kinds of transforms
    int64_t count = 0;
    for (size_t at = 0; at < chain.size(); at += size_t(1 + inputs[chain[at]])) count += inputs[chain[at]];
    Floats const own(numbers.begin(), numbers.begin() + count);
    of_columns = of_columns + b.call("transform_matrix_backward",
                                     {{"grad", grads[2]}, {"columns", columns}, {"plan", chain}, {"numbers", own}})[0];
  }
  return {of_image, of_columns, Tensor()};
};

inline constexpr Rule warp_and_color{warp_and_color_gradients, 2};

inline constexpr Rule gaussian_noise{noise_gradients<"gaussian_noise">};
inline constexpr Rule uniform_noise{noise_gradients<"uniform_noise">};
inline constexpr Rule elastic_displacements{[](Backward const& b) -> variable_list {
  if (b.optional(1)) return {Tensor()};
  Tensor const grad = b.grad();
  Tensor const scaled =
      at::stack({grad.select(1, 0) * b.arguments[8].toDouble(), grad.select(1, 1) * b.arguments[9].toDouble()}, 1);
  return {b.call("gaussian_blur2d_backward", {{"grad", scaled}, {"sigma", {}}, {"border", int64_t(0)}})[0]};
}};
inline constexpr Rule erase_rectangles{[](Backward const& b) { return erased_gradients(b, "erase_rectangles"); }};
inline constexpr Rule erase_grid{[](Backward const& b) { return erased_gradients(b, "erase_grid"); }};

}  // namespace kvision::ops::detail::rules
