// Regions, distances and patches. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

inline variable_list extract_patches_gradients(Backward const& b);
inline variable_list combine_patches_gradients(Backward const& b);

}  // namespace detail

// --- contrib/connected_components_op.cpp

inline constexpr Operator<"connected_components", Tensor(Tensor input)> connected_components{non_differentiable};

// --- contrib/diamond_square_op.cpp

inline constexpr Operator<"refine_fractal", Tensor(Tensor images, Tensor noise, Tensor weights)> refine_fractal{
    no_gradient};

// --- contrib/distance_exact_op.cpp

inline constexpr Operator<"distance_transform_exact", Tensor(Tensor input)> distance_transform_exact{
    non_differentiable};

// --- contrib/distance_step_op.cpp

inline constexpr Operator<"distance_transform_step",
                          Two(Tensor grown, Tensor total, Tensor kernel, double distance, double h)>
    distance_transform_step{no_gradient};

// --- contrib/patches_op.cpp

inline constexpr Operator<"extract_patches", Tensor(Tensor input, Ints size, Ints window, Ints stride, Ints padding)>
    extract_patches{Rule{detail::extract_patches_gradients, 0, false}};
inline constexpr Operator<"combine_patches", Tensor(Tensor patches, Ints size, Ints window, Ints stride, Ints padding)>
    combine_patches{Rule{detail::combine_patches_gradients, 0, false}};

// --- rules

namespace detail {

inline variable_list extract_patches_gradients(Backward const& b) {
  return b.run("combine_patches", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               Rule{combine_patches_gradients, 0, false});
}

inline variable_list combine_patches_gradients(Backward const& b) {
  return b.run("extract_patches", {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               Rule{extract_patches_gradients, 0, false});
}

}  // namespace detail

}  // namespace kvision::ops
