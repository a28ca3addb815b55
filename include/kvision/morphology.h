// Morphology of images (B, C, H, W), as python/kvision/morphology has it. A second derivative is an error.
#pragma once

#include "kvision/ops/morphology.h"
#include "kvision/types.h"

namespace kvision {

struct MorphologyOptions {
  TORCH_ARG(std::optional<Tensor>, structuring_element);  // heights of the members (kH, kW), without a gradient
  TORCH_ARG(std::optional<Size2d>, origin);               // (y, x) in the kernel, its center if there is none
  TORCH_ARG(std::optional<double>, border_value);         // what is outside; without it nothing is
};

namespace detail {

inline Tensor dilated(char const* op, Tensor const& x, Tensor const& kernel, MorphologyOptions const& options,
                      bool erode) {
  images(op, "tensor", x);
  shaped(op, "kernel", kernel, 2, "(kH, kW)");
  Size2d const origin = options.origin().value_or(Size2d({kernel.size(0) / 2, kernel.size(1) / 2}));
  auto heights = computed(options.structuring_element(), x);
  if (heights) same_shape(op, "structuring_element", *heights, kernel);
  return ops::dilation(x, computed(kernel != 0, x).unsqueeze(0),
                       heights ? std::optional(heights->unsqueeze(0)) : heights, origin->at(0), origin->at(1),
                       options.border_value().value_or(erode ? INFINITY : -INFINITY), erode);
}

// Bytes saturate, they do not wrap.
inline Tensor difference(Tensor const& x, Tensor const& y) {
  return x.scalar_type() == at::kByte ? at::maximum(x, y) - y : x - y;
}

}  // namespace detail

inline Tensor dilation(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return detail::dilated("dilation", tensor, kernel, options, false);
}
inline Tensor erosion(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return detail::dilated("erosion", tensor, kernel, options, true);
}
inline Tensor opening(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return dilation(erosion(tensor, kernel, options), kernel, options);
}
inline Tensor closing(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return erosion(dilation(tensor, kernel, options), kernel, options);
}
inline Tensor gradient(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return detail::difference(dilation(tensor, kernel, options), erosion(tensor, kernel, options));
}
inline Tensor top_hat(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return detail::difference(tensor, opening(tensor, kernel, options));
}
inline Tensor bottom_hat(Tensor const& tensor, Tensor const& kernel, MorphologyOptions const& options = {}) {
  return detail::difference(closing(tensor, kernel, options), tensor);
}

}  // namespace kvision
