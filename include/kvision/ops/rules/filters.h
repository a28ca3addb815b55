// Gradients of filters that are no single call.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops::detail::rules {

inline constexpr Rule canny_suppress{[](Backward const& b) -> variable_list {
                                       return b.call("sobel_backward",
                                                     {{"grad", b.grad() * (b.results[0] > 0)}, {"normalized", false}});
                                     },
                                     2};

inline constexpr Rule gaussian_levels{[](Backward const& b) -> variable_list {
                                        Ints const sizes = b.arguments[1].toIntVector();
                                        Floats const sigmas = b.arguments[2].toDoubleVector();
                                        Tensor grad = b.grad().select(2, int64_t(sizes.size()));
                                        for (size_t i = sizes.size(); i-- > 0;)
                                          grad = b.grad().select(2, int64_t(i)) +
                                                 b.call("gaussian_blur2d_backward", {{"grad", grad},
                                                                                     {"sigma", c10::IValue()},
                                                                                     {"ky", sizes[i]},
                                                                                     {"kx", sizes[i]},
                                                                                     {"sigma_y", sigmas[i]},
                                                                                     {"sigma_x", sigmas[i]}})[0];
                                        return {grad};
                                      },
                                      0, false};
inline constexpr Rule bilateral_blur{
    [](Backward const& b) -> variable_list {
      variable_list gradients(4);
      if (b.needs(0) || b.needs(1)) {
        bool const kept = b.arguments.back().toBool();
        variable_list const images =
            b.call("bilateral_blur_backward", {{"output", kept ? c10::IValue(b.results[0].detach()) : c10::IValue()},
                                               {"totals", kept ? c10::IValue(b.results[1]) : c10::IValue()},
                                               {"wants_input", b.needs(0)},
                                               {"wants_guidance", b.needs(1)}});
        std::copy(images.begin(), images.end(), gradients.begin());
      }
      if (b.needs(2) || b.needs(3)) {
        Tensor const x = b.tensor(0);
        auto const type = x.scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
        Tensor const sums =
            b.call("bilateral_blur_sigma_sums", {{"grad", b.grad().to(type)}, {"input", x.to(type)}})[0].sum(2);
        if (b.needs(2)) gradients[2] = sums.select(1, 0) / b.tensor(2).pow(3);
        if (b.needs(3)) gradients[3] = sums.narrow(1, 1, 2) / b.tensor(3).pow(3);
      }
      return gradients;
    },
    2};

inline constexpr Rule filter2d_clamped{[](Backward const& b) -> variable_list {
  Tensor const y = b.call("filter2d", {{"same", true}})[0];
  Tensor const grad = b.grad().masked_fill((y < 0).logical_or(y > 1), 0);
  return {b.needs(0) ? b.call("filter2d_backward", {{"grad", grad}, {"same", true}})[0] : Tensor(),
          b.needs(1) ? b.call("filter2d_kernel_backward", {{"grad", grad}, {"same", true}})[0] : Tensor()};
}};

// Of filter2d_separable (input, kernels) and its transpose (grad, kernels).
inline constexpr Rule filter2d_separable{[](Backward const& b) -> variable_list {
  bool const is_transpose = name_of(b.op) == "filter2d_separable_backward";
  char const* const other = is_transpose ? "filter2d_separable" : "filter2d_separable_backward";
  char const* const role = is_transpose ? "input" : "grad";
  variable_list gradients{b.needs(0) ? b.call(other, {{role, b.grad()}}, filter2d_separable)[0] : Tensor()};
  if (b.needs(1) || b.needs(2)) {
    Tensor const kernels = b.call("filter2d_separable_weights_backward", {{role, b.grad()}})[0];
    for (Tensor const& part : kernels.split_with_sizes({b.tensor(1).size(1), b.tensor(2).size(1)}, 1))
      gradients.push_back(part);
  }
  return gradients;
}};

}  // namespace kvision::ops::detail::rules
