// Local features. Arguments are those of torch.ops.kvision.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

// --- formulas of local affine frames -------------------------------------------------------------------------------

inline constexpr Operator<"laf_scale", Tensor(Tensor laf)> laf_scale{side_by_side};
inline constexpr Operator<"rotate_laf", Tensor(Tensor laf, Tensor degrees)> rotate_laf{side_by_side};
inline constexpr Operator<"set_laf_orientation", Tensor(Tensor laf, Tensor degrees)> set_laf_orientation{side_by_side};
inline constexpr Operator<"laf_from_parts",
                          Tensor(Tensor center, std::optional<Tensor> scale, std::optional<Tensor> degrees)>
    laf_from_parts{side_by_side};
inline constexpr Operator<"scale_laf_parts", Tensor(Tensor laf, double shape, double x, double y)> scale_laf_parts{
    side_by_side};
inline constexpr Operator<"make_upright", Tensor(Tensor laf, double eps)> make_upright{side_by_side};
inline constexpr Operator<"ellipse_to_laf", Tensor(Tensor ellipse)> ellipse_to_laf{side_by_side};
inline constexpr Operator<"perspective_transform_laf", Tensor(Tensor homography, Tensor laf)> perspective_transform_laf{
    side_by_side};

// --- matching ------------------------------------------------------------------------------------------------------

namespace detail {

// From the distances of the first set's neighbors; those of the second set are constants.
inline constexpr Rule two_nearest{
    [](Backward const& b) {
      Tensor const none = at::zeros_like(b.results[1]);
      return b.call("two_nearest_backward",
                    {{"grad1", b.grad()}, {"grad2", none}, {"indices1", b.results[0]}, {"indices2", b.results[2]}});
    },
    3};

}  // namespace detail

inline constexpr Operator<"two_nearest",
                          Four(Tensor desc1, Tensor desc2, OptionalTensor mask1, OptionalTensor mask2,
                               OptionalTensor positions1, OptionalTensor positions2, double distance, bool both)>
    two_nearest{detail::two_nearest};

}  // namespace kvision::ops
