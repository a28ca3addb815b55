// Warps, depth, peaks, several views and matrices of transforms. Arguments are those of torch.ops.kvision. Written by
// tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/geometry.h"

namespace kvision::ops {

namespace detail {

inline variable_list undistort_map_gradients(Backward const& b);
inline variable_list correspondence_errors_gradients(Backward const& b);
inline variable_list reprojection_gradients(Backward const& b);
inline variable_list nearest_essential_gradients(Backward const& b);
inline variable_list essential_motions_gradients(Backward const& b);
inline variable_list triangulate_gradients(Backward const& b);
inline variable_list homography_dlt_gradients(Backward const& b);
inline variable_list homography_lines_dlt_gradients(Backward const& b);
inline variable_list fundamental_dlt_gradients(Backward const& b);
inline variable_list affine_fit_gradients(Backward const& b);
inline variable_list pose_dlt_gradients(Backward const& b);
inline variable_list normalize_points_gradients(Backward const& b);
inline variable_list null_vector_gradients(Backward const& b);
inline variable_list apply_nms_mask_gradients(Backward const& b);
inline variable_list conv_quad_interp3d_gradients(Backward const& b);
inline variable_list render_gaussian2d_gradients(Backward const& b);
inline variable_list soft_argmax_gradients(Backward const& b);
inline variable_list spatial_expectation_gradients(Backward const& b);
inline variable_list flip_gradients(Backward const& b);
inline variable_list crop_gradients(Backward const& b);
inline variable_list resize_gradients(Backward const& b);
inline variable_list resize_backward_gradients(Backward const& b);
inline variable_list resize_windows_gradients(Backward const& b);
inline variable_list resize_windows_backward_gradients(Backward const& b);
inline variable_list thin_plate_points_gradients(Backward const& b);
inline variable_list thin_plate_map_gradients(Backward const& b);
inline variable_list transform_points_gradients(Backward const& b);

}  // namespace detail

// --- geometry/calibration/distortion_op.cpp

inline constexpr Operator<"undistort_points", Tensor(Tensor points, Tensor camera, Tensor new_camera,
                                                     Tensor coefficients, OptionalTensor tilt, int64_t steps)>
    undistort_points{no_gradient};
inline constexpr Operator<"distort_points", Tensor(Tensor points, Tensor camera, Tensor new_camera, Tensor coefficients,
                                                   OptionalTensor tilt)>
    distort_points{no_gradient};
inline constexpr Operator<"undistort_map", Tensor(Tensor camera, Tensor coefficients, OptionalTensor tilt, Ints size)>
    undistort_map{Rule{detail::undistort_map_gradients}};

// --- geometry/calibration/robust_poses_op.cpp

inline constexpr Operator<"robust_poses",
                          Three(Tensor hypotheses, Tensor points, Tensor pixels, Tensor camera, OptionalTensor mask,
                                double threshold, double reach, int64_t rounds, int64_t steps, double tolerance)>
    robust_poses{non_differentiable};

// --- geometry/calibration/sample_poses_op.cpp

inline constexpr Operator<"sample_poses", Tensor(Tensor points, Tensor pixels, Tensor camera, Tensor samples)>
    sample_poses{non_differentiable};

// --- geometry/correspondence_errors_op.cpp

inline constexpr Operator<"correspondence_errors",
                          Tensor(Tensor points1, Tensor points2, Tensor matrix, int64_t kind, bool squared)>
    correspondence_errors{Rule{detail::correspondence_errors_gradients}};

// --- geometry/depth/photometric_op.cpp

inline constexpr Operator<"photometric_depth", Four(Tensor views, Tensor target, Tensor depth, Tensor projections,
                                                    int64_t distance, double eps)>
    photometric_depth{detail::rules::photometric_depth};

// --- geometry/depth/points_op.cpp

inline constexpr Operator<"depth_points", Tensor(Tensor depth, Tensor camera, bool distance, bool last)> depth_points{
    detail::rules::depth_points};
inline constexpr Operator<"depth_normals", Tensor(Tensor depth, Tensor camera, bool distance)> depth_normals{
    detail::rules::depth_normals};

// --- geometry/depth/reprojection_op.cpp

inline constexpr Operator<"reprojection", Tensor(Tensor camera_to, Tensor pose_to, Tensor camera_from,
                                                 OptionalTensor pose_from, bool pinhole)>
    reprojection{Rule{detail::reprojection_gradients}};

// --- geometry/depth/warp_op.cpp

inline constexpr Operator<"depth_warp", Tensor(Tensor image, Tensor depth, Tensor projection, int64_t interpolation,
                                               int64_t padding, bool align_corners)>
    depth_warp{detail::rules::depth_warp};

// --- geometry/detection/suppression_op.cpp

inline constexpr Operator<"suppress_boxes", Tensor(Tensor edges, OptionalTensor labels, double threshold)>
    suppress_boxes{non_differentiable};
inline constexpr Operator<"soft_suppress_boxes", Two(Tensor edges, Tensor scores, OptionalTensor labels,
                                                     double threshold, double sigma, double min_score, int64_t decay)>
    soft_suppress_boxes{non_differentiable};

// --- geometry/epipolar/essential_op.cpp

inline constexpr Operator<"nearest_essential", Tensor(Tensor matrix)> nearest_essential{
    Rule{detail::nearest_essential_gradients}};
inline constexpr Operator<"essential_motions", Two(Tensor matrix)> essential_motions{
    Rule{detail::essential_motions_gradients}};
inline constexpr Operator<"motion_choice", Five(Tensor matrix, Tensor camera1, Tensor camera2, Tensor points1,
                                                Tensor points2, OptionalTensor mask)>
    motion_choice{no_gradient};

// --- geometry/epipolar/triangulation_op.cpp

inline constexpr Operator<"triangulate",
                          Tensor(Tensor points1, Tensor points2, Tensor projections1, Tensor projections2)>
    triangulate{Rule{detail::triangulate_gradients}};

// --- geometry/optim/fit_bundle_op.cpp

inline constexpr Operator<"fit_bundle",
                          Five(Tensor poses, Tensor points, Tensor pixels, Tensor camera, Tensor camera_index,
                               Tensor point_index, Tensor by_camera, Tensor camera_offsets, Tensor point_offsets,
                               OptionalTensor weights, int64_t loss, double scale, int64_t max_iterations, double ftol,
                               double xtol, double gtol)>
    fit_bundle{non_differentiable};

// --- geometry/optim/fit_poses_op.cpp

inline constexpr Operator<"fit_poses",
                          Four(Tensor start, Tensor points, Tensor pixels, Tensor camera, OptionalTensor weights,
                               int64_t max_iterations, double ftol, double xtol, double gtol)>
    fit_poses{non_differentiable};

// --- geometry/optim/group_products_op.cpp

inline constexpr Operator<"group_products", Tensor(Tensor left, Tensor right, Tensor left_rows, Tensor right_rows,
                                                   Tensor offsets, OptionalTensor middle, OptionalTensor middle_rows)>
    group_products{no_gradient};

// --- geometry/ransac_op.cpp

inline constexpr Operator<"select_inliers", Two(Tensor points1, Tensor points2, OptionalTensor weights,
                                                Tensor thresholds, Tensor models, int64_t model)>
    select_inliers{non_differentiable};
inline constexpr Operator<"keep_best_models",
                          Three(Tensor models, Tensor points1, Tensor points2, Tensor kept, Tensor kept_scores,
                                Tensor thresholds, Tensor existing, int64_t count, bool by_count, int64_t model,
                                double confidence, int64_t budget)>
    keep_best_models{non_differentiable};

// --- geometry/solvers/dlt_op.cpp

inline constexpr Operator<"homography_dlt", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)>
    homography_dlt{Rule{detail::homography_dlt_gradients}};
inline constexpr Operator<"homography_lines_dlt", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)>
    homography_lines_dlt{Rule{detail::homography_lines_dlt_gradients}};
inline constexpr Operator<"fundamental_dlt", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)>
    fundamental_dlt{Rule{detail::fundamental_dlt_gradients}};
inline constexpr Operator<"affine_fit", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)> affine_fit{
    Rule{detail::affine_fit_gradients}};
inline constexpr Operator<"pose_dlt",
                          Tensor(Tensor points, Tensor pixels, Tensor camera, OptionalTensor weights, double flat)>
    pose_dlt{Rule{detail::pose_dlt_gradients}};
inline constexpr Operator<"normalize_points", Two(Tensor points, OptionalTensor weights, double eps)> normalize_points{
    Rule{detail::normalize_points_gradients}};

// --- geometry/solvers/minimal_op.cpp

inline constexpr Operator<"minimal_solver", Tensor(Tensor points1, Tensor points2, OptionalTensor draws, int64_t model)>
    minimal_solver{no_gradient};

// --- geometry/solvers/null_vector_op.cpp

inline constexpr Operator<"null_vector", Tensor(Tensor rows, OptionalTensor weights)> null_vector{
    Rule{detail::null_vector_gradients, 1}};
inline constexpr Operator<"eigenvectors", Two(Tensor matrix)> eigenvectors{non_differentiable};

// --- geometry/solvers/roots_op.cpp

inline constexpr Operator<"real_roots", Tensor(Tensor coefficients)> real_roots{detail::rules::real_roots};
inline constexpr Operator<"first_root", Tensor(Tensor coefficients)> first_root{detail::rules::first_root};

// --- geometry/solvers/two_view_fits_op.cpp

inline constexpr Operator<"two_view_fits", Two(Tensor models, Tensor points1, Tensor points2, OptionalTensor weights,
                                               Tensor reaches, int64_t rounds, int64_t model, bool adapts)>
    two_view_fits{non_differentiable};

// --- geometry/subpix/nms_op.cpp

inline constexpr Operator<"nms", Two(Tensor input, Ints window, bool volumes, bool marked)> nms{detail::rules::nms};
inline constexpr Operator<"apply_nms_mask", Tensor(Tensor input, Tensor flags)> apply_nms_mask{
    Rule{detail::apply_nms_mask_gradients, 0, false}};
inline constexpr Operator<"nms_mask", Tensor(Tensor input, Ints window, bool volumes)> nms_mask{
    detail::rules::nms_mask};
inline constexpr Operator<"nms_minmax_masks", Two(Tensor input, Ints window, bool volumes)> nms_minmax_masks{
    detail::rules::nms_minmax_masks};

// --- geometry/subpix/quad_interp3d_op.cpp

inline constexpr Operator<"conv_quad_interp3d", Two(Tensor input, OptionalTensor chosen, int64_t steps,
                                                    double largest_shift, int64_t radius, bool along_scale)>
    conv_quad_interp3d{Rule{detail::conv_quad_interp3d_gradients}};

// --- geometry/subpix/render_gaussian2d_op.cpp

inline constexpr Operator<"render_gaussian2d",
                          Tensor(Tensor mean, Tensor std, int64_t height, int64_t width, bool normalized)>
    render_gaussian2d{Rule{detail::render_gaussian2d_gradients}};

// --- geometry/subpix/soft_argmax_op.cpp

inline constexpr Operator<"soft_argmax", Two(Tensor input, Ints window, Ints stride, Ints padding, double temperature,
                                             bool normalized, bool scale_too, bool with_values)>
    soft_argmax{Rule{detail::soft_argmax_gradients}};

// --- geometry/subpix/spatial_expectation_op.cpp

inline constexpr Operator<"spatial_expectation", Two(Tensor input, bool softmax, double scale, bool normalized)>
    spatial_expectation{Rule{detail::spatial_expectation_gradients, 2}};

// --- geometry/transform/antialiased/warp_antialiased_op.cpp

// Their arguments are those of `warp` and `remap`, without an interpolation.
inline constexpr Operator<"warp_antialiased",
                          Tensor(Tensor image, Tensor matrix, OptionalTensor fill, OptionalTensor image_index,
                                 Ints size, int64_t padding, bool align_corners, bool inverse, bool normalized)>
    warp_antialiased{detail::rules::warp_antialiased};
inline constexpr Operator<"remap_antialiased", Tensor(Tensor image, Tensor map_x, Tensor map_y, OptionalTensor fill,
                                                      OptionalTensor image_index, int64_t padding, bool align_corners,
                                                      bool normalized, bool moves)>
    remap_antialiased{detail::rules::remap_antialiased};

// --- geometry/transform/composed/composed_warp_op.cpp

// Where the pixels of a result of that size read after a chain of links, matrices (B, 3, 3) and displacements
// (B, 2, H, W), the first one first: (B, 2, h, w). composed_warp.py explains them.
inline constexpr Operator<"composed_coords",
                          Tensor(Tensor a, OptionalTensor b, OptionalTensor c, OptionalTensor d, OptionalTensor e,
                                 OptionalTensor f, OptionalTensor g, OptionalTensor h, Ints size)>
    composed_coords{detail::rules::composed_coords};
inline constexpr Operator<"composed_warp", Tensor(Tensor image, Tensor a, OptionalTensor b, OptionalTensor c,
                                                  OptionalTensor d, OptionalTensor e, OptionalTensor f,
                                                  OptionalTensor g, OptionalTensor h, OptionalTensor fill, Ints size,
                                                  int64_t interpolation, int64_t padding, bool align_corners)>
    composed_warp{detail::rules::composed_warp};

// --- geometry/transform/composed/link_coords_list_op.cpp

// Where the pixels of results of a height and width each read before a link: matrices (B, 3, 3), or maps (2, H, W) of
// sizes `before` it in one tensor; behind it they read at `coordinates`, or at themselves. (2, h, w) of each in one
// tensor, as remap_list takes them.
inline constexpr Operator<"link_coords_list", Tensor(Tensor link, OptionalTensor coordinates, Ints before, Ints sides)>
    link_coords_list{no_gradient};

// --- geometry/transform/flip_op.cpp

inline constexpr Operator<"flip", Tensor(Tensor input, bool columns, bool rows)> flip{
    Rule{detail::flip_gradients, 0, false}};
inline constexpr Operator<"crop", Tensor(Tensor input, Ints corner, Ints size)> crop{
    Rule{detail::crop_gradients, 0, false}};

// --- geometry/transform/photometric_op.cpp

inline constexpr Operator<"photometric", Two(Tensor source, Tensor target, Tensor matrix, int64_t distance, double eps,
                                             bool align_corners, bool normalized)>
    photometric{detail::rules::photometric};
inline constexpr Operator<"photometric_normal_equations",
                          Three(Tensor source, Tensor target, Tensor matrix, int64_t distance, double eps,
                                bool align_corners, bool normalized)>
    photometric_normal_equations{non_differentiable};

// --- geometry/transform/remap_op.cpp

inline constexpr Operator<"remap", Tensor(Tensor image, Tensor map_x, Tensor map_y, OptionalTensor fill,
                                          OptionalTensor image_index, int64_t interpolation, int64_t padding,
                                          bool align_corners, bool normalized, bool moves)>
    remap{detail::rules::remap};

// --- geometry/transform/resize/resize_op.cpp

inline constexpr Operator<"resize", Tensor(Tensor input, Ints size, int64_t filter, bool align_corners, bool antialias,
                                           int64_t border)>
    resize{Rule{detail::resize_gradients, 0, false}};
inline constexpr Operator<"pyramid_detail", Tensor(Tensor smaller, Tensor image, bool align_corners, int64_t border)>
    pyramid_detail{detail::rules::pyramid_detail};

// --- geometry/transform/resize/resize_windows_op.cpp

// `matrix` (B, 3, 3), without rotation and shear, maps pixels of the images to those of the results.
inline constexpr Operator<"resize_windows",
                          Tensor(Tensor input, Tensor matrix, Ints size, int64_t filter, bool align_corners)>
    resize_windows{Rule{detail::resize_windows_gradients, 0, false}};
inline constexpr Operator<"resize_views", Tensor(Tensor input, Tensor boxes, Ints size, int64_t filter)> resize_views{
    no_gradient};

// --- geometry/transform/thin_plate_op.cpp

inline constexpr Operator<"thin_plate_points", Tensor(Tensor points, Tensor centers, Tensor weights, Tensor affine)>
    thin_plate_points{Rule{detail::thin_plate_points_gradients}};
inline constexpr Operator<"thin_plate_map",
                          Tensor(Tensor centers, Tensor weights, Tensor affine, Ints size, bool align_corners)>
    thin_plate_map{Rule{detail::thin_plate_map_gradients}};
inline constexpr Operator<"thin_plate_weights", Tensor(Tensor centers, Tensor rhs)> thin_plate_weights{
    detail::rules::thin_plate_weights};

// --- geometry/transform/warp3d_op.cpp

inline constexpr Operator<"warp3d", Tensor(Tensor volumes, Tensor matrix, Ints size, int64_t interpolation,
                                           int64_t padding, bool align_corners, bool inverse, bool normalized)>
    warp3d{detail::rules::warp3d};
inline constexpr Operator<"warp3d_by_formula",
                          Tensor(Tensor volumes, OptionalTensor a, OptionalTensor b, OptionalTensor c, OptionalTensor d,
                                 OptionalTensor e, OptionalTensor f, int64_t formula, Floats numbers, Ints size,
                                 int64_t interpolation, int64_t padding, bool align_corners, bool inverse,
                                 bool normalized)>
    warp3d_by_formula{detail::rules::warp3d_by_formula};

// --- geometry/transform/warp_op.cpp

// Samples may outnumber the images: `image_index` (N,), of int64 or int32, has the image that each of them reads.
// Without it one image serves all samples, or sample b reads image b.
inline constexpr Operator<"warp", Tensor(Tensor image, Tensor matrix, OptionalTensor fill, OptionalTensor image_index,
                                         Ints size, int64_t interpolation, int64_t padding, bool align_corners,
                                         bool inverse, bool normalized)>
    warp{detail::rules::warp};
inline constexpr Operator<"warp_by_formula",
                          Tensor(Tensor image, OptionalTensor a, OptionalTensor b, OptionalTensor c, OptionalTensor d,
                                 OptionalTensor e, OptionalTensor f, OptionalTensor image_index, int64_t formula,
                                 Floats numbers, Ints size, int64_t interpolation, int64_t padding, bool align_corners,
                                 bool inverse, bool normalized)>
    warp_by_formula{detail::rules::warp_by_formula};

// --- geometry/transform_points_op.cpp

inline constexpr Operator<"transform_points", Tensor(Tensor points, OptionalTensor depth, Tensor matrix, int64_t kind)>
    transform_points{Rule{detail::transform_points_gradients}};

// --- formulas

inline constexpr Operator<"affine_matrix2d",
                          Tensor(Tensor degrees, OptionalTensor translation, OptionalTensor scale,
                                 OptionalTensor shear_x, OptionalTensor shear_y, OptionalTensor center, double sign,
                                 double x, double y, int64_t rows)>
    affine_matrix2d{side_by_side};
inline constexpr Operator<"affine_matrix3d",
                          Tensor(Tensor x, Tensor y, Tensor z, OptionalTensor translation, OptionalTensor scale,
                                 OptionalTensor center, OptionalTensor xy, OptionalTensor xz, OptionalTensor yx,
                                 OptionalTensor yz, OptionalTensor zx, OptionalTensor zy, double sign, double center_x,
                                 double center_y, double center_z, int64_t rows)>
    affine_matrix3d{side_by_side};
inline constexpr Operator<"angle_to_rotation_matrix", Tensor(Tensor degrees)> angle_to_rotation_matrix{side_by_side};
inline constexpr Operator<"axis_angle_to_rotation_matrix", Tensor(Tensor axis_angle)> axis_angle_to_rotation_matrix{
    side_by_side};
inline constexpr Operator<"camera_motion",
                          Tensor(Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2)>
    camera_motion{side_by_side};
inline constexpr Operator<"compose_poses", Tensor(Tensor first, Tensor second)> compose_poses{side_by_side};
inline constexpr Operator<"crop_box_checks", Tensor(Tensor quads, Tensor others)> crop_box_checks{side_by_side};
inline constexpr Operator<"crop_matrix", Tensor(Tensor quads, OptionalTensor first, double across, double down)>
    crop_matrix{side_by_side};
inline constexpr Operator<"cross_matrix", Tensor(Tensor vector)> cross_matrix{side_by_side};
inline constexpr Operator<"decompose_projection", Tensor(Tensor projection)> decompose_projection{side_by_side};
inline constexpr Operator<"determinant_to_polynomial", Tensor(Tensor A)> determinant_to_polynomial{side_by_side};
inline constexpr Operator<"essential_from_fundamental", Tensor(Tensor fundamental, Tensor camera1, Tensor camera2)>
    essential_from_fundamental{side_by_side};
inline constexpr Operator<"essential_from_motions",
                          Tensor(Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2)>
    essential_from_motions{side_by_side};
inline constexpr Operator<"euler_from_quaternion", Tensor(Tensor w, Tensor x, Tensor y, Tensor z)>
    euler_from_quaternion{side_by_side};
inline constexpr Operator<"fundamental_from_essential", Tensor(Tensor essential, Tensor camera1, Tensor camera2)>
    fundamental_from_essential{side_by_side};
inline constexpr Operator<"fundamental_from_projections", Tensor(Tensor projection1, Tensor projection2)>
    fundamental_from_projections{side_by_side};
inline constexpr Operator<"invert_affine2d", Tensor(Tensor matrix)> invert_affine2d{side_by_side};
inline constexpr Operator<"invert_pose", Tensor(Tensor pose)> invert_pose{side_by_side};
inline constexpr Operator<"normalize_line", Tensor(Tensor line)> normalize_line{side_by_side};
inline constexpr Operator<"normalize_quaternion", Tensor(Tensor quaternion, double eps)> normalize_quaternion{
    side_by_side};
inline constexpr Operator<"perspective_matrix", Tensor(Tensor points_src, Tensor points_dst)> perspective_matrix{
    side_by_side};
inline constexpr Operator<"perspective_matrix3d",
                          Tensor(Tensor points_src, OptionalTensor points_dst, double x, double y, double z)>
    perspective_matrix3d{side_by_side};
inline constexpr Operator<"product_of_linear", Tensor(Tensor a, Tensor b)> product_of_linear{side_by_side};
inline constexpr Operator<"product_of_quadratic", Tensor(Tensor a, Tensor b)> product_of_quadratic{side_by_side};
inline constexpr Operator<"quaternion_exponential", Tensor(Tensor vector, double part)> quaternion_exponential{
    side_by_side};
inline constexpr Operator<"quaternion_from_euler", Tensor(Tensor roll, Tensor pitch, Tensor yaw)> quaternion_from_euler{
    side_by_side};
inline constexpr Operator<"quaternion_logarithm", Tensor(Tensor quaternion)> quaternion_logarithm{side_by_side};
inline constexpr Operator<"quaternion_product", Tensor(Tensor left, Tensor right)> quaternion_product{side_by_side};
inline constexpr Operator<"quaternion_to_axis_angle", Tensor(Tensor quaternion)> quaternion_to_axis_angle{side_by_side};
inline constexpr Operator<"quaternion_to_rotation_matrix", Tensor(Tensor quaternion)> quaternion_to_rotation_matrix{
    side_by_side};
inline constexpr Operator<"relative_pose", Tensor(Tensor first, Tensor second)> relative_pose{side_by_side};
inline constexpr Operator<"rotation_matrix_to_axis_angle", Tensor(Tensor matrix)> rotation_matrix_to_axis_angle{
    side_by_side};
inline constexpr Operator<"rotation_matrix_to_quaternion", Tensor(Tensor matrix)> rotation_matrix_to_quaternion{
    side_by_side};
inline constexpr Operator<"scale_matrix2d", Tensor(Tensor scale, OptionalTensor center, double x, double y)>
    scale_matrix2d{side_by_side};
inline constexpr Operator<"se2_exp", Tensor(Tensor tangent)> se2_exp{side_by_side};
inline constexpr Operator<"se2_log", Tensor(Tensor motion)> se2_log{side_by_side};
inline constexpr Operator<"se3_exp", Tensor(Tensor tangent)> se3_exp{side_by_side};
inline constexpr Operator<"se3_left_jacobian", Tensor(Tensor tangent)> se3_left_jacobian{side_by_side};
inline constexpr Operator<"se3_left_jacobian_inverse", Tensor(Tensor tangent)> se3_left_jacobian_inverse{side_by_side};
inline constexpr Operator<"se3_log", Tensor(Tensor motion)> se3_log{side_by_side};
inline constexpr Operator<"shear_factor_matrix2d", Tensor(Tensor factors)> shear_factor_matrix2d{side_by_side};
inline constexpr Operator<"shear_matrix2d", Tensor(Tensor center, OptionalTensor shear_x, OptionalTensor shear_y)>
    shear_matrix2d{side_by_side};
inline constexpr Operator<"shear_matrix3d",
                          Tensor(Tensor center, OptionalTensor xy, OptionalTensor xz, OptionalTensor yx,
                                 OptionalTensor yz, OptionalTensor zx, OptionalTensor zy)>
    shear_matrix3d{side_by_side};
inline constexpr Operator<"so3_left_jacobian", Tensor(Tensor tangent)> so3_left_jacobian{side_by_side};
inline constexpr Operator<"so3_left_jacobian_inverse", Tensor(Tensor tangent)> so3_left_jacobian_inverse{side_by_side};
inline constexpr Operator<"translation_matrix2d", Tensor(Tensor translation, double x, double y, int64_t rows)>
    translation_matrix2d{side_by_side};
inline constexpr Operator<"translation_matrix3d",
                          Tensor(Tensor translation, double x, double y, double z, int64_t rows)>
    translation_matrix3d{side_by_side};

// --- rules

namespace detail {

inline variable_list undistort_map_gradients(Backward const& b) {
  return b.run("undistort_map_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list correspondence_errors_gradients(Backward const& b) {
  return b.run("correspondence_errors_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

inline variable_list reprojection_gradients(Backward const& b) {
  return b.run("reprojection_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

inline variable_list nearest_essential_gradients(Backward const& b) {
  return b.run("nearest_essential_backward", {b.grads[0], b.arguments[0]}, no_gradient);
}

inline variable_list essential_motions_gradients(Backward const& b) {
  return b.run("essential_motions_backward", {b.grads[0], b.grads[1], b.arguments[0]}, no_gradient);
}

inline variable_list triangulate_gradients(Backward const& b) {
  return b.run("triangulate_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3]},
               no_gradient);
}

inline variable_list homography_dlt_gradients(Backward const& b) {
  return b.run("homography_dlt_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list homography_lines_dlt_gradients(Backward const& b) {
  return b.run("homography_lines_dlt_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]},
               no_gradient);
}

inline variable_list fundamental_dlt_gradients(Backward const& b) {
  return b.run("fundamental_dlt_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list affine_fit_gradients(Backward const& b) {
  return b.run("affine_fit_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list pose_dlt_gradients(Backward const& b) {
  return b.run("pose_dlt_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

inline variable_list normalize_points_gradients(Backward const& b) {
  return b.run("normalize_points_backward", {b.grads[0], b.grads[1], b.arguments[0], b.arguments[1], b.arguments[2]},
               no_gradient);
}

inline variable_list null_vector_gradients(Backward const& b) {
  return b.run("null_vector_backward", {b.grads[0], b.results[0], b.arguments[0], b.arguments[1]}, no_gradient);
}

inline variable_list apply_nms_mask_gradients(Backward const& b) {
  return b.run("apply_nms_mask", {b.grads[0], b.arguments[1]}, Rule{apply_nms_mask_gradients, 0, false});
}

inline variable_list conv_quad_interp3d_gradients(Backward const& b) {
  return b.run("conv_quad_interp3d_backward",
               {b.grads[0], b.grads[1], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                b.arguments[5]},
               no_gradient);
}

inline variable_list render_gaussian2d_gradients(Backward const& b) {
  return b.run("render_gaussian2d_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[4]}, no_gradient);
}

inline variable_list soft_argmax_gradients(Backward const& b) {
  return b.run("soft_argmax_backward",
               {b.grads[0], b.grads[1], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                b.arguments[5], b.arguments[6], b.arguments[7]},
               no_gradient);
}

inline variable_list spatial_expectation_gradients(Backward const& b) {
  return b.run("spatial_expectation_backward",
               {b.grads[0], b.results[0], b.results[1], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3]},
               no_gradient);
}

inline variable_list flip_gradients(Backward const& b) {
  return b.run("flip", {b.grads[0], b.arguments[1], b.arguments[2]}, Rule{flip_gradients, 0, false});
}

inline variable_list crop_gradients(Backward const& b) {
  return b.run("crop", {b.grads[0], minus(b.arguments[1]), b.image_size()}, Rule{crop_gradients, 0, false});
}

inline variable_list resize_gradients(Backward const& b) {
  return b.run("resize_backward",
               {b.grads[0], b.image_size(), b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5]},
               Rule{resize_backward_gradients, 0, false});
}

inline variable_list resize_backward_gradients(Backward const& b) {
  return b.run("resize", {b.grads[0], b.image_size(), b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5]},
               Rule{resize_gradients, 0, false});
}

inline variable_list resize_windows_gradients(Backward const& b) {
  return b.run("resize_windows_backward", {b.grads[0], b.arguments[1], b.image_size(), b.arguments[3], b.arguments[4]},
               Rule{resize_windows_backward_gradients, 0, false});
}

inline variable_list resize_windows_backward_gradients(Backward const& b) {
  return b.run("resize_windows", {b.grads[0], b.arguments[1], b.image_size(), b.arguments[3], b.arguments[4]},
               Rule{resize_windows_gradients, 0, false});
}

inline variable_list thin_plate_points_gradients(Backward const& b) {
  return b.run("thin_plate_points_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3]}, no_gradient);
}

inline variable_list thin_plate_map_gradients(Backward const& b) {
  return b.run("thin_plate_map_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[4]},
               no_gradient);
}

inline variable_list transform_points_gradients(Backward const& b) {
  return b.run("transform_points_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.needs(2)}, no_gradient);
}

}  // namespace detail

}  // namespace kvision::ops
