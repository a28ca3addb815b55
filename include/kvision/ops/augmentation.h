// Random parameters, the matrices that they give, noise and erased rectangles. Arguments are those of
// torch.ops.kvision, plans and numbers those of python/kvision/augmentation/draws.py, transforms.py and noise.py.
#pragma once

#include <ATen/ExpandUtils.h>
#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

// The mean and the deviation have the sums of the gradient and of its product with the noise alone.
inline constexpr auto noise_gradients = [](Backward const& b) -> variable_list {
  if (!b.needs(1)) return {b.grad()};
  Tensor const parameters = b.tensor(1), grad = b.grad().to(parameters.scalar_type());
  Tensor const standard = at::stack({at::zeros({1}, parameters.options()), at::ones({1}, parameters.options())}, 1);
  Tensor const noise = b.call("gaussian_noise", {{"images", at::zeros_like(grad)}, {"parameters", standard}})[0];
  OptionalTensor const chosen = b.optional(4);
  Tensor const kept = chosen ? grad * (*chosen != 0).view({-1, 1, 1, 1}) : grad;
  Tensor const to_each = at::stack({kept.sum({1, 2, 3}), (grad * noise).sum({1, 2, 3})}, 1);
  return {b.grad(), at::sum_to(to_each, parameters.sizes())};
};

inline constexpr auto erased_gradients = [](Backward const& b) -> variable_list {
  Tensor const values = b.tensor(2),
               kept = b.call("erase_rectangles", {{"images", b.grad()}, {"values", at::zeros_like(values)}})[0];
  if (!b.needs(2)) return {kept};
  return {kept, Tensor(), at::sum_to((b.grad() - kept).to(values.scalar_type()).sum({1, 2, 3}), values.sizes())};
};

}  // namespace detail

inline constexpr Operator<"draw_parameters",
                          Tensor(Tensor images, Tensor keys, OptionalTensor seeds, Ints plan, Floats numbers)>
    draw_parameters{non_differentiable};
inline constexpr Operator<"transform_matrix", Tensor(Tensor columns, Ints plan, Floats numbers)> transform_matrix{
    from<"transform_matrix_backward">};

inline constexpr Operator<"gaussian_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                   OptionalTensor chosen, Ints plan)>
    gaussian_noise{detail::noise_gradients};
inline constexpr Operator<"salt_and_pepper", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                    OptionalTensor chosen, Ints plan)>
    salt_and_pepper{from<"salt_and_pepper_backward">};
inline constexpr Operator<"erase_rectangles", Tensor(Tensor images, Tensor boxes, Tensor values)> erase_rectangles{
    detail::erased_gradients};

}  // namespace kvision::ops
