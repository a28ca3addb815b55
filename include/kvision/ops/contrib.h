// Regions, distances and patches. Arguments are those of torch.ops.kvision.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

inline constexpr Operator<"connected_components", Tensor(Tensor input)> connected_components{non_differentiable};
inline constexpr Operator<"distance_transform_step",
                          Two(Tensor grown, Tensor total, Tensor kernel, double distance, double h)>
    distance_transform_step{no_gradient};
inline constexpr Operator<"distance_transform_exact", Tensor(Tensor input)> distance_transform_exact{
    non_differentiable};

namespace detail {

// Patches are cut out of an image and added up in one.
inline constexpr Rule patches{[](Backward const& b) {
                                bool const extracts = name_of(b.op) == "extract_patches";
                                return b.call(extracts ? "combine_patches" : "extract_patches",
                                              {{extracts ? "patches" : "input", b.grad()}}, patches);
                              },
                              0, false};

}  // namespace detail

inline constexpr Operator<"extract_patches", Tensor(Tensor input, Ints size, Ints window, Ints stride, Ints padding)>
    extract_patches{detail::patches};
inline constexpr Operator<"combine_patches", Tensor(Tensor patches, Ints size, Ints window, Ints stride, Ints padding)>
    combine_patches{detail::patches};

}  // namespace kvision::ops
