// Local features. Arguments are those of torch.ops.kvision.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

// --- formulas of local affine frames -------------------------------------------------------------------------------

inline constexpr Operator<"laf_scale", Tensor(Tensor laf)> laf_scale{side_by_side};
inline constexpr Operator<"rotate_laf", Tensor(Tensor laf, Tensor degrees)> rotate_laf{side_by_side};
inline constexpr Operator<"set_laf_orientation", Tensor(Tensor laf, Tensor degrees)> set_laf_orientation{side_by_side};
inline constexpr Operator<"laf_from_parts", Tensor(Tensor center, OptionalTensor scale, OptionalTensor degrees)>
    laf_from_parts{side_by_side};
inline constexpr Operator<"scale_laf_parts", Tensor(Tensor laf, double shape, double x, double y)> scale_laf_parts{
    side_by_side};
inline constexpr Operator<"laf_of_peak", Tensor(Tensor peak, Tensor scale, double levels_of_octave, double x, double y)>
    laf_of_peak{side_by_side};
inline constexpr Operator<"make_upright", Tensor(Tensor laf, double eps)> make_upright{side_by_side};
inline constexpr Operator<"ellipse_to_laf", Tensor(Tensor ellipse)> ellipse_to_laf{side_by_side};
inline constexpr Operator<"quadratic_peak2d", Tensor(Tensor values)> quadratic_peak2d{side_by_side};
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

// From the distances.
inline constexpr Rule nearest_pairs{
    [](Backward const& b) { return b.call("nearest_pairs_backward", {{"indices", b.results[0]}}); }, 1};

// From the scores. Indices and counts are constants.
inline constexpr Rule select_matches{[](Backward const& b) -> variable_list {
                                       variable_list const gradients =
                                           b.call("select_matches_backward", {{"indices", b.results[0]}});
                                       return {gradients[0], Tensor(), gradients[1], Tensor()};
                                     },
                                     2};

}  // namespace detail

// The distances (B, N, 1) of the nearest descriptors, and the indices (B, N, 2) of a descriptor and its nearest one.
inline constexpr Operator<"nearest_pairs", Two(Tensor desc1, Tensor desc2)> nearest_pairs{detail::nearest_pairs};
// The matches of each sample, from the neighbors (B, N, 2) of the first set and, if matches are mutual, those of the
// second set, which has count2 descriptors: scores (B, N), indices (B, N, 2), and the count of matches (B,).
inline constexpr Operator<"select_matches",
                          Three(Tensor distances1, Tensor indices1, OptionalTensor distances2, OptionalTensor indices2,
                                int64_t count2, bool ratios, double threshold)>
    select_matches{detail::select_matches};
inline constexpr Operator<"two_nearest",
                          Four(Tensor desc1, Tensor desc2, OptionalTensor mask1, OptionalTensor mask2,
                               OptionalTensor positions1, OptionalTensor positions2, double distance, bool both)>
    two_nearest{detail::two_nearest};

// --- patches -------------------------------------------------------------------------------------------------------

// A pyramid (B, C, P) has the rows of all levels of an image of `size`, one after the other. Gradients are sums in the
// type that computes.
inline constexpr Operator<"sample_patches", Tensor(Tensor pyramid, Tensor laf, Ints size, int64_t levels,
                                                   int64_t patch_size, double window)>
    sample_patches{[](Backward const& b) -> variable_list {
      variable_list gradients =
          b.call("sample_patches_backward", {{"wants_pyramid", b.needs(0)}, {"wants_laf", b.needs(1)}});
      for (size_t i = 0; i < 2; ++i) gradients[i] = b.needs(i) ? gradients[i].to(b.tensor(i).scalar_type()) : Tensor();
      return gradients;
    }};
// `sample_patches` of a pyramid that the operator builds. Only Python has the gradient.
inline constexpr Operator<"pyramid_patches",
                          Tensor(Tensor input, Tensor laf, int64_t levels, int64_t patch_size, double window)>
    pyramid_patches{no_gradient};
inline constexpr Operator<"sift",
                          Tensor(Tensor patches, int64_t angular_bins, int64_t spatial_bins, double clip, bool root)>
    sift{from<"sift_backward">};
inline constexpr Operator<"orientation",
                          Tensor(Tensor patches, int64_t bins, double eps, int64_t peaks, double threshold)>
    orientation{from<"orientation_backward">};
inline constexpr Operator<"orientation_slots", Two(Tensor laf, Tensor responses, Tensor angles)> orientation_slots{
    no_gradient};
inline constexpr Operator<"affine_shape", Tensor(Tensor patches, double eps)> affine_shape{
    from<"affine_shape_backward">};

// --- responses -----------------------------------------------------------------------------------------------------

// Only Python has the gradients to k and to the sigmas.
inline constexpr Operator<"corner_response", Tensor(Tensor input, OptionalTensor k, OptionalTensor sigmas,
                                                    double fixed_k, int64_t kind, int64_t mode)>
    corner_response{from<"corner_response_backward">};
inline constexpr Operator<"hessian_response", Tensor(Tensor input, OptionalTensor sigmas, int64_t mode)>
    hessian_response{from<"hessian_response_backward">};
inline constexpr Operator<"difference_of_gaussians", Tensor(Tensor input, double sigma1, double sigma2)>
    difference_of_gaussians{linear};

// --- detection -----------------------------------------------------------------------------------------------------

// Levels (B, L, H, W), weights (B, H, W) and scales (B,) to peaks (B, N, 4), which are level, x, y and value, and
// voxels (B, N). On the CPU only.
inline constexpr Operator<"scale_space_peaks",
                          Two(Tensor levels, OptionalTensor weights, Tensor scales, bool differences, bool minima,
                              int64_t count, double levels_of_octave, double margin, double edge_ratio,
                              double threshold, int64_t steps, double largest_shift, int64_t radius, bool along_scale)>
    scale_space_peaks{from<"scale_space_peaks_backward", 1>};

// Images (B, 1, H, W) to the frames (B, N, 2, 3) and scores (B, N) of the strongest peaks of their scale space. Only
// Python has the gradient.
inline constexpr Operator<"scale_space_features",
                          Two(Tensor input, Ints sizes, Ints windows, Floats sigmas, int64_t next, Floats blurs,
                              int64_t mode, bool minima, int64_t count, double scale, double levels_of_octave,
                              double margin, double edge_ratio, double threshold, int64_t steps, double largest_shift,
                              int64_t radius, bool along_scale)>
    scale_space_features{no_gradient};

}  // namespace kvision::ops
