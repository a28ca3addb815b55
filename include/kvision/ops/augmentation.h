// Random parameters, the matrices that they give, passes over images, noise and erased rectangles. Arguments are those
// of torch.ops.kvision, plans and numbers those of python/kvision/augmentation/draws.py, transforms.py,
// warp_and_color.py and noise.py.
#pragma once

#include <ATen/ExpandUtils.h>
#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

// The mean and the scale have the sums of the gradient and of its product with the noise alone.
template <Name op>
inline constexpr auto noise_gradients = [](Backward const& b) -> variable_list {
  if (!b.needs(1)) return {b.grad()};
  Tensor const parameters = b.tensor(1), grad = b.grad().to(parameters.scalar_type());
  Tensor const standard = at::stack({at::zeros({1}, parameters.options()), at::ones({1}, parameters.options())}, 1);
  Tensor const noise = b.call(op.text, {{"images", at::zeros_like(grad)}, {"parameters", standard}})[0];
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

}  // namespace detail

inline constexpr Operator<"draw_parameters",
                          Tensor(Tensor images, Tensor keys, OptionalTensor seeds, Ints plan, Floats numbers)>
    draw_parameters{non_differentiable};
inline constexpr Operator<"transform_matrix", Tensor(Tensor columns, Ints plan, Floats numbers)> transform_matrix{
    from<"transform_matrix_backward">};

// A warp by the matrices of a chain of transforms of columns (B, P), then a program of color steps: the result, the
// matrices, and the means of contrast. warp_and_color.py explains size, plan and numbers.
inline constexpr Operator<"warp_and_color", Three(Tensor image, OptionalTensor columns, OptionalTensor fill, Ints size,
                                                  Ints plan, Floats numbers)>
    warp_and_color{detail::warp_and_color_gradients, 2};

inline constexpr Operator<"gaussian_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                   OptionalTensor chosen, Ints plan)>
    gaussian_noise{detail::noise_gradients<"gaussian_noise">};
inline constexpr Operator<"uniform_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                  OptionalTensor chosen, Ints plan)>
    uniform_noise{detail::noise_gradients<"uniform_noise">};
// Displacements of elastic transforms: given noise (B, 2, H, W), or noise drawn by keys, after a Gaussian blur, times
// the scales.
inline constexpr Operator<"elastic_displacements",
                          Tensor(Tensor noise, OptionalTensor keys, OptionalTensor seeds, Ints plan, int64_t ky,
                                 int64_t kx, double sigma_y, double sigma_x, double scale_x, double scale_y)>
    elastic_displacements{[](Backward const& b) -> variable_list {
      if (b.optional(1)) return {Tensor()};
      Tensor const grad = b.grad();
      Tensor const scaled =
          at::stack({grad.select(1, 0) * b.arguments[8].toDouble(), grad.select(1, 1) * b.arguments[9].toDouble()}, 1);
      return {b.call("gaussian_blur2d_backward", {{"grad", scaled}, {"sigma", {}}, {"border", int64_t(0)}})[0]};
    }};
inline constexpr Operator<"salt_and_pepper", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                    OptionalTensor chosen, Ints plan)>
    salt_and_pepper{from<"salt_and_pepper_backward">};
inline constexpr Operator<"erase_rectangles", Tensor(Tensor images, Tensor boxes, Tensor values)> erase_rectangles{
    detail::erased_gradients};

// A step of a policy: each image (B, 3, H, W) gets the operation of its number, with its value; -1 is none. Returns the
// images and the matrices (B, 3, 3) of operations that move pixels. operation_table.py has the numbers and the values.
inline constexpr Operator<"apply_operation", Two(Tensor images, Tensor operation, Tensor value)> apply_operation{
    [](Backward const& b) -> variable_list {
      TORCH_CHECK_NOT_IMPLEMENTED(!b.needs(2), "apply_operation: C++ has no gradient of value; Python's kvision has");
      return {b.call("apply_operation_backward")[0]};
    },
    1};

// Where a map of nodes reads the inside of quadrilaterals, and points. preimages.py says what the arguments are.
inline constexpr Operator<"preimage_extents", Tensor(Tensor quads, Tensor directions, Tensor coordinates, Tensor kinds,
                                                     Tensor x, Tensor y, int64_t margin)>
    preimage_extents{non_differentiable};
inline constexpr Operator<"preimage_points",
                          Two(Tensor points, Tensor coordinates, Tensor kinds, Tensor x, Tensor y, int64_t margin)>
    preimage_points{non_differentiable};

}  // namespace kvision::ops
