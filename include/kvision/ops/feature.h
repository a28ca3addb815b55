// Local features. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/feature.h"

namespace kvision::ops {

namespace detail {

inline variable_list affine_shape_gradients(Backward const& b);
inline variable_list select_matches_gradients(Backward const& b);
inline variable_list nearest_pairs_gradients(Backward const& b);
inline variable_list orientation_gradients(Backward const& b);
inline variable_list sample_patches_gradients(Backward const& b);
inline variable_list difference_of_gaussians_gradients(Backward const& b);
inline variable_list difference_of_gaussians_backward_gradients(Backward const& b);
inline variable_list corner_response_gradients(Backward const& b);
inline variable_list hessian_response_gradients(Backward const& b);
inline variable_list scale_space_peaks_gradients(Backward const& b);
inline variable_list sift_gradients(Backward const& b);

}  // namespace detail

// --- feature/affine_shape_op.cpp

inline constexpr Operator<"affine_shape", Tensor(Tensor patches, double eps)> affine_shape{
    Rule{detail::affine_shape_gradients}};

// --- feature/matching_op.cpp

// The matches of each sample, from the neighbors (B, N, 2) of the first set and, if matches are mutual, those of the
// second set, which has count2 descriptors: scores (B, N), indices (B, N, 2), and the count of matches (B,).
inline constexpr Operator<"select_matches",
                          Three(Tensor distances1, Tensor indices1, OptionalTensor distances2, OptionalTensor indices2,
                                int64_t count2, bool ratios, double threshold)>
    select_matches{Rule{detail::select_matches_gradients, 2}};
// The distances (B, N, 1) of the nearest descriptors, and the indices (B, N, 2) of a descriptor and its nearest one.
inline constexpr Operator<"nearest_pairs", Two(Tensor desc1, Tensor desc2)> nearest_pairs{
    Rule{detail::nearest_pairs_gradients, 1}};
inline constexpr Operator<"two_nearest",
                          Four(Tensor desc1, Tensor desc2, OptionalTensor mask1, OptionalTensor mask2,
                               OptionalTensor positions1, OptionalTensor positions2, double distance, bool both)>
    two_nearest{detail::rules::two_nearest};

// --- feature/orientation_op.cpp

inline constexpr Operator<"orientation",
                          Tensor(Tensor patches, int64_t bins, double eps, int64_t peaks, double threshold)>
    orientation{Rule{detail::orientation_gradients}};

// --- feature/orientation_slots_op.cpp

inline constexpr Operator<"orientation_slots", Two(Tensor laf, Tensor responses, Tensor angles)> orientation_slots{
    no_gradient};

// --- feature/patches_op.cpp

// A pyramid (B, C, P) has the rows of all levels of an image of `size`, one after the other.
inline constexpr Operator<"sample_patches", Tensor(Tensor pyramid, Tensor laf, Ints size, int64_t levels,
                                                   int64_t patch_size, double window)>
    sample_patches{Rule{detail::sample_patches_gradients}};
// `sample_patches` of a pyramid that the operator builds.
inline constexpr Operator<"pyramid_patches",
                          Tensor(Tensor input, Tensor laf, int64_t levels, int64_t patch_size, double window)>
    pyramid_patches{no_gradient};

// --- feature/responses_op.cpp

inline constexpr Operator<"difference_of_gaussians", Tensor(Tensor input, double sigma1, double sigma2)>
    difference_of_gaussians{Rule{detail::difference_of_gaussians_gradients, 0, false}};
inline constexpr Operator<"corner_response", Tensor(Tensor input, OptionalTensor k, OptionalTensor sigmas,
                                                    double fixed_k, int64_t kind, int64_t mode)>
    corner_response{Rule{detail::corner_response_gradients}};
inline constexpr Operator<"hessian_response", Tensor(Tensor input, OptionalTensor sigmas, int64_t mode)>
    hessian_response{Rule{detail::hessian_response_gradients}};

// --- feature/scale_space/scale_space_features_op.cpp

// Images (B, 1, H, W) to the frames (B, N, 2, 3) and scores (B, N) of the strongest peaks of their scale space.
inline constexpr Operator<"scale_space_features",
                          Two(Tensor input, Ints sizes, Ints windows, Floats sigmas, int64_t next, Floats blurs,
                              int64_t mode, bool minima, int64_t count, double scale, double levels_of_octave,
                              double margin, double edge_ratio, double threshold, int64_t steps, double largest_shift,
                              int64_t radius, bool along_scale)>
    scale_space_features{no_gradient};

// --- feature/scale_space/scale_space_peaks_op.cpp

// Levels (B, L, H, W), weights (B, H, W) and scales (B,) to peaks (B, N, 4), which are level, x, y and value, and
// voxels (B, N). On the CPU only.
inline constexpr Operator<"scale_space_peaks",
                          Two(Tensor levels, OptionalTensor weights, Tensor scales, bool differences, bool minima,
                              int64_t count, double levels_of_octave, double margin, double edge_ratio,
                              double threshold, int64_t steps, double largest_shift, int64_t radius, bool along_scale)>
    scale_space_peaks{Rule{detail::scale_space_peaks_gradients, 1}};

// --- feature/sift_op.cpp

inline constexpr Operator<"sift",
                          Tensor(Tensor patches, int64_t angular_bins, int64_t spatial_bins, double clip, bool root)>
    sift{Rule{detail::sift_gradients}};

// --- formulas

inline constexpr Operator<"ellipse_to_laf", Tensor(Tensor ellipse)> ellipse_to_laf{side_by_side};
inline constexpr Operator<"laf_from_parts", Tensor(Tensor center, OptionalTensor scale, OptionalTensor degrees)>
    laf_from_parts{side_by_side};
inline constexpr Operator<"laf_of_peak", Tensor(Tensor peak, Tensor scale, double levels_of_octave, double x, double y)>
    laf_of_peak{side_by_side};
inline constexpr Operator<"laf_scale", Tensor(Tensor laf)> laf_scale{side_by_side};
inline constexpr Operator<"make_upright", Tensor(Tensor laf, double eps)> make_upright{side_by_side};
inline constexpr Operator<"perspective_transform_laf", Tensor(Tensor homography, Tensor laf)> perspective_transform_laf{
    side_by_side};
inline constexpr Operator<"quadratic_peak2d", Tensor(Tensor values)> quadratic_peak2d{side_by_side};
inline constexpr Operator<"rotate_laf", Tensor(Tensor laf, Tensor degrees)> rotate_laf{side_by_side};
inline constexpr Operator<"scale_laf_parts", Tensor(Tensor laf, double shape, double x, double y)> scale_laf_parts{
    side_by_side};
inline constexpr Operator<"set_laf_orientation", Tensor(Tensor laf, Tensor degrees)> set_laf_orientation{side_by_side};

// --- rules

namespace detail {

inline variable_list affine_shape_gradients(Backward const& b) {
  return b.run("affine_shape_backward", {b.grads[0], b.arguments[0], b.arguments[1]}, no_gradient);
}

inline variable_list select_matches_gradients(Backward const& b) {
  variable_list gradients(3);
  if (b.needs(0) || b.needs(2)) {
    variable_list const computed =
        b.run("select_matches_backward",
              {b.grads[0], b.results[0], b.arguments[0], b.arguments[2], b.arguments[4], b.arguments[5]}, no_gradient);
    gradients[0] = computed[0];
    gradients[2] = computed[1];
  }
  return gradients;
}

inline variable_list nearest_pairs_gradients(Backward const& b) {
  return b.run("nearest_pairs_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.results[0]}, no_gradient);
}

inline variable_list orientation_gradients(Backward const& b) {
  return b.run("orientation_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

inline variable_list sample_patches_gradients(Backward const& b) {
  return b.run("sample_patches_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                b.arguments[5], b.needs(0), b.needs(1)},
               no_gradient);
}

inline variable_list difference_of_gaussians_gradients(Backward const& b) {
  return b.run("difference_of_gaussians_backward", {b.grads[0], b.arguments[1], b.arguments[2]},
               Rule{difference_of_gaussians_backward_gradients, 0, false});
}

inline variable_list difference_of_gaussians_backward_gradients(Backward const& b) {
  return b.run("difference_of_gaussians", {b.grads[0], b.arguments[1], b.arguments[2]},
               Rule{difference_of_gaussians_gradients, 0, false});
}

inline variable_list corner_response_gradients(Backward const& b) {
  return b.run(
      "corner_response_backward",
      {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5]},
      no_gradient);
}

inline variable_list hessian_response_gradients(Backward const& b) {
  return b.run("hessian_response_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list scale_space_peaks_gradients(Backward const& b) {
  return b.run("scale_space_peaks_backward",
               {b.grads[0], b.arguments[0], b.results[0], b.arguments[3], b.arguments[10], b.arguments[11],
                b.arguments[12], b.arguments[13]},
               no_gradient);
}

inline variable_list sift_gradients(Backward const& b) {
  return b.run("sift_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

}  // namespace detail

}  // namespace kvision::ops
