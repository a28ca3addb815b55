// Losses. Arguments are those of torch.ops.kvision.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

inline constexpr Operator<"overlap", Two(Tensor pred, Tensor target, OptionalTensor weight, bool micro, double alpha,
                                         double beta, double eps, int64_t ignored, bool ignores)>
    overlap{from<"overlap_backward", 1>};
inline constexpr Operator<"focal", Tensor(Tensor pred, Tensor target, OptionalTensor weight, double first, double other,
                                          double gamma, int64_t ignored, bool ignores, bool summed)>
    focal{from<"focal_backward">};
inline constexpr Operator<"lovasz", Two(Tensor pred, Tensor target, bool hinge)> lovasz{from<"lovasz_backward", 1>};
inline constexpr Operator<"hausdorff", Tensor(Tensor pred, Tensor target, double alpha, int64_t k, bool summed)>
    hausdorff{from<"hausdorff_backward">};
inline constexpr Operator<"binary_focal",
                          Tensor(Tensor pred, Tensor target, OptionalTensor yes, OptionalTensor no, double of_yes,
                                 double of_no, double gamma, double ignored, bool ignores, bool summed)>
    binary_focal{from_each<"binary_focal_backward", "by_target">};
inline constexpr Operator<"total_variation", Tensor(Tensor input, double along_y, double along_x)> total_variation{
    from<"total_variation_backward">};
inline constexpr Operator<"smoothness", Tensor(Tensor depth, Tensor image, double along_y, double along_x)> smoothness{
    from_each<"smoothness_backward", "of_image">};
inline constexpr Operator<"mutual_information",
                          Three(Tensor input, Tensor other, OptionalTensor input_mask, OptionalTensor other_mask,
                                int64_t kernel, int64_t bins, double radius, bool normalized)>
    mutual_information{from_each<"mutual_information_backward", "by_other", 2>};

}  // namespace kvision::ops
