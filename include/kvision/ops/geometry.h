// Warps, depth, peaks, several views and matrices of transforms. Arguments are those of torch.ops.kvision.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops {

// Numbers of modes. They are those of Python and never change.
enum class PointMap : int64_t { transform, project, unproject, unproject_distance, intersect };
enum class Model : int64_t { affine, homography, lines, fundamental, fundamental8, essential };
enum class CorrespondenceError : int64_t {
  sampson,
  symmetrical,
  right,
  left,
  transfer,
  symmetric_transfer,
  sampson_transfer,
  segments
};
enum class WarpFormula : int64_t {
  affine_matrix2d = 1,
  translation_matrix2d,
  scale_matrix2d,
  shear_factor_matrix2d,
  crop_matrix,
  affine_matrix3d,
  translation_matrix3d,
  perspective_matrix3d
};
inline constexpr int64_t kPyrDown = 6, kPyrUp = 7;  // filters of resize; the others have the numbers of Interpolation

// --- warps -----------------------------------------------------------------------------------------------------------

namespace detail {

// To the fill of what is outside: the fraction of each pixel that is outside of the image.
template <class Inside>
Tensor to_fill(Backward const& b, Tensor const& fill, Inside const& inside) {
  Tensor const x = b.tensor(0), weights = inside(x.new_ones({1, 1, x.size(2), x.size(3)}));
  return ((1 - weights) * b.grad()).to(fill.scalar_type()).sum({2, 3});
}

inline Tensor cast(Tensor const& x, Tensor const& like) { return x.to(like.scalar_type()); }

}  // namespace detail

// Samples may outnumber the images: `image_index` (N,), of int64 or int32, has the image that each of them reads.
// Without it one image serves all samples, or sample b reads image b.
inline constexpr Operator<"warp", Tensor(Tensor image, Tensor matrix, OptionalTensor fill, OptionalTensor image_index,
                                         Ints size, int64_t interpolation, int64_t padding, bool align_corners,
                                         bool inverse, bool normalized)>
    warp{[](Backward const& b) -> variable_list {
      Tensor const fill = b.tensor(2);
      auto const inside = [&](Tensor const& ones) {
        return b.call(warp, {{"image", ones}, {"fill", {}}, {"image_index", {}}})[0];
      };
      return {b.needs(0) ? b.call("warp_image_backward", {{"size", b.batch_size()}})[0] : Tensor(),
              b.needs(1) ? b.call("warp_matrix_backward")[0] : Tensor(),
              b.needs(2) ? detail::to_fill(b, fill, inside) : Tensor()};
    }};
inline constexpr Operator<"remap", Tensor(Tensor image, Tensor map_x, Tensor map_y, OptionalTensor fill,
                                          OptionalTensor image_index, int64_t interpolation, int64_t padding,
                                          bool align_corners, bool normalized, bool moves)>
    remap{[](Backward const& b) -> variable_list {
      variable_list gradients{b.needs(0) ? b.call("remap_image_backward", {{"size", b.batch_size()}})[0] : Tensor()};
      variable_list const maps = b.needs(1) || b.needs(2) ? b.call("remap_map_backward") : variable_list(2);
      gradients.insert(gradients.end(), maps.begin(), maps.end());
      auto const inside = [&](Tensor const& ones) {
        return b.call(remap, {{"image", ones}, {"fill", {}}, {"image_index", {}}})[0];
      };
      gradients.push_back(b.needs(3) ? detail::to_fill(b, b.tensor(3), inside) : Tensor());
      return gradients;
    }};

namespace detail {

inline constexpr char const* kLinks[] = {"a", "b", "c", "d", "e", "f", "g", "h"};

// The gradients to the links of a chain, arguments `first` and on, from those of the coordinates that they compose to.
inline variable_list link_gradients(Backward const& b, Tensor const& grad, size_t first) {
  Ints needs_grad;
  for (size_t i = 0; i < std::size(kLinks); ++i)
    needs_grad.push_back(b.tensor(first + i).defined() && b.needs(first + i));
  variable_list gradients = b.call("composed_coords_backward", {{"grad", grad}, {"needs_grad", needs_grad}});
  for (size_t i = 0; i < std::size(kLinks); ++i)
    gradients[i] = needs_grad[i] ? at::sum_to(gradients[i], b.tensor(first + i).sizes()) : Tensor();
  return gradients;
}

}  // namespace detail

// Where the pixels of a result of that size read after a chain of links, matrices (B, 3, 3) and displacements
// (B, 2, H, W), the first one first: (B, 2, h, w). composed_warp.py explains them.
inline constexpr Operator<"composed_coords",
                          Tensor(Tensor a, OptionalTensor b, OptionalTensor c, OptionalTensor d, OptionalTensor e,
                                 OptionalTensor f, OptionalTensor g, OptionalTensor h, Ints size)>
    composed_coords{
        [](Backward const& b) -> variable_list { return detail::link_gradients(b, b.grad().contiguous(), 0); }};
inline constexpr Operator<"composed_warp", Tensor(Tensor image, Tensor a, OptionalTensor b, OptionalTensor c,
                                                  OptionalTensor d, OptionalTensor e, OptionalTensor f,
                                                  OptionalTensor g, OptionalTensor h, OptionalTensor fill, Ints size,
                                                  int64_t interpolation, int64_t padding, bool align_corners)>
    composed_warp{[](Backward const& b) -> variable_list {
      constexpr size_t fill = 1 + std::size(detail::kLinks);
      Tensor const coords = b.call("composed_coords")[0], x = coords.select(1, 0), y = coords.select(1, 1);
      variable_list gradients(fill + 1);
      auto const remap_by = [&](char const* op, std::pair<std::string_view, c10::IValue> const& other) {
        return b.call(
            op, {{"map_x", x}, {"map_y", y}, {"image_index", {}}, {"normalized", false}, {"moves", false}, other});
      };
      if (b.needs(0)) gradients[0] = remap_by("remap_image_backward", {"size", b.batch_size()})[0];
      bool needs_links = false;
      for (size_t i = 1; i < fill; ++i) needs_links = needs_links || b.needs(i);
      if (needs_links) {
        variable_list const maps = remap_by("remap_map_backward", {"fill", b.optional(fill)});
        variable_list const links = detail::link_gradients(b, at::stack({maps[0], maps[1]}, 1), 1);
        std::copy(links.begin(), links.end(), gradients.begin() + 1);
      }
      if (b.needs(fill)) {
        auto const inside = [&](Tensor const& ones) {
          return b.call("remap", {{"image", ones},
                                  {"map_x", x},
                                  {"map_y", y},
                                  {"fill", {}},
                                  {"image_index", {}},
                                  {"normalized", false},
                                  {"moves", false}})[0];
        };
        gradients[fill] = detail::to_fill(b, b.tensor(fill), inside);
      }
      return gradients;
    }};
inline constexpr Operator<"warp3d", Tensor(Tensor volumes, Tensor matrix, Ints size, int64_t interpolation,
                                           int64_t padding, bool align_corners, bool inverse, bool normalized)>
    warp3d{[](Backward const& b) -> variable_list {
      Tensor const x = b.tensor(0), m = b.tensor(1), grad = detail::cast(b.grad(), m);
      return {b.needs(0) ? b.call("warp3d_volume_backward", {{"grad", grad}, {"size", b.image_size()}})[0] : Tensor(),
              b.needs(1) ? b.call("warp3d_matrix_backward", {{"grad", grad}, {"volumes", detail::cast(x, m)}})[0]
                         : Tensor()};
    }};

namespace detail {

// The operators of WarpFormula, by its numbers.
inline constexpr char const* kWarpFormulas[] = {"",
                                                "affine_matrix2d",
                                                "translation_matrix2d",
                                                "scale_matrix2d",
                                                "shear_factor_matrix2d",
                                                "crop_matrix",
                                                "affine_matrix3d",
                                                "translation_matrix3d",
                                                "perspective_matrix3d"};

// A warp by the matrix of a formula: the gradients to image and matrix, and from the matrix to the tensors a to f of
// the formula.
template <Name image_gradient, Name matrix_gradient, int64_t rows>
inline constexpr Rule by_formula{[](Backward const& b) -> variable_list {
  auto const& names = b.op.schema().arguments();
  auto const value = [&](std::string_view name) {
    auto const is_it = [&](c10::Argument const& a) { return a.name() == name; };
    return b.arguments[std::find_if(names.begin(), names.end(), is_it) - names.begin()];
  };
  auto const formula = find(kWarpFormulas[value("formula").toInt()]);
  auto const numbers = value("numbers").toDoubleVector();
  size_t next_tensor = 1, next_number = 0;
  Arguments arguments;
  for (c10::Argument const& argument : formula.schema().arguments()) {
    if (argument.type()->kind() == c10::TypeKind::FloatType)
      arguments.push_back(numbers.at(next_number++));
    else if (argument.type()->kind() == c10::TypeKind::IntType)
      arguments.push_back(rows);
    else
      arguments.push_back(next_tensor <= 6 ? b.arguments[next_tensor++] : c10::IValue());
  }
  // A translation by numbers alone.
  auto const type = b.grad().scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
  if (arguments[0].isNone()) arguments[0] = at::zeros({1, int64_t(numbers.size())}, b.grad().options().dtype(type));
  Tensor const matrix = run(formula, side_by_side, arguments)[0];
  Tensor const grad = rows == 3 ? cast(b.grad(), matrix) : b.grad();
  Ints const size = rows == 3 ? b.image_size() : b.batch_size();
  variable_list gradients{
      b.needs(0) ? b.call(image_gradient.text, {{"grad", grad}, {"matrix", matrix}, {"size", size}})[0] : Tensor()};
  bool needs_matrix = false;
  for (size_t i = 1; i <= 6; ++i) needs_matrix = needs_matrix || b.needs(i);
  if (!needs_matrix) return gradients;
  Tensor const x = b.tensor(0);
  Tensor const to_matrix =
      b.call(matrix_gradient.text, {{"grad", grad}, {"volumes", cast(x, matrix)}, {"matrix", matrix}, {"fill", {}}})[0];
  auto const needs = [&](size_t i) { return b.needs(i + 1); };
  auto const tensors = side_by_side.gradients({formula, {to_matrix}, arguments, {}, {}, needs});
  gradients.insert(gradients.end(), tensors.begin(), tensors.begin() + std::min<size_t>(6, tensors.size()));
  return gradients;
}};

}  // namespace detail

inline constexpr Operator<"warp_by_formula",
                          Tensor(Tensor image, OptionalTensor a, OptionalTensor b, OptionalTensor c, OptionalTensor d,
                                 OptionalTensor e, OptionalTensor f, OptionalTensor image_index, int64_t formula,
                                 Floats numbers, Ints size, int64_t interpolation, int64_t padding, bool align_corners,
                                 bool inverse, bool normalized)>
    warp_by_formula{detail::by_formula<"warp_image_backward", "warp_matrix_backward", 2>};
inline constexpr Operator<"warp3d_by_formula",
                          Tensor(Tensor volumes, OptionalTensor a, OptionalTensor b, OptionalTensor c, OptionalTensor d,
                                 OptionalTensor e, OptionalTensor f, int64_t formula, Floats numbers, Ints size,
                                 int64_t interpolation, int64_t padding, bool align_corners, bool inverse,
                                 bool normalized)>
    warp3d_by_formula{detail::by_formula<"warp3d_volume_backward", "warp3d_matrix_backward", 3>};

// --- resizing --------------------------------------------------------------------------------------------------------

namespace detail {

// Of an operator and of its backward operator, which are linear.
inline constexpr Rule resized{[](Backward const& b) {
                                std::string name = name_of(b.op);
                                bool const back = name.ends_with("_backward");
                                name = back ? name.substr(0, name.size() - 9) : name + "_backward";
                                return b.call(name, {{back ? "input" : "grad", b.grad()}, {"size", b.image_size()}},
                                              resized);
                              },
                              0, false};

}  // namespace detail

inline constexpr Operator<"resize", Tensor(Tensor input, Ints size, int64_t filter, bool align_corners, bool antialias,
                                           int64_t border)>
    resize{detail::resized};
// `matrix` (B, 3, 3), without rotation and shear, maps pixels of the images to those of the results.
inline constexpr Operator<"resize_windows",
                          Tensor(Tensor input, Tensor matrix, Ints size, int64_t filter, bool align_corners)>
    resize_windows{detail::resized};
inline constexpr Operator<"pyramid_detail", Tensor(Tensor smaller, Tensor image, bool align_corners, int64_t border)>
    pyramid_detail{
        [](Backward const& b) -> variable_list {
          c10::IValue const size = b.image_size();
          return {b.needs(0) ? -b.call("resize_backward", {{"size", size}, {"filter", kPyrUp}, {"antialias", false}},
                                       detail::resized)[0]
                             : Tensor(),
                  b.grad()};
        },
        0, false};
inline constexpr Operator<"flip", Tensor(Tensor input, bool columns, bool rows)> flip{
    [](Backward const& b) { return b.call(flip, {{"input", b.grad()}}); }, 0, false};
inline constexpr Operator<"crop", Tensor(Tensor input, Ints corner, Ints size)> crop{
    [](Backward const& b) {
      auto const corner = b.arguments[1].toIntVector();
      return b.call(crop, {{"input", b.grad()}, {"corner", Ints{-corner[0], -corner[1]}}, {"size", b.image_size()}});
    },
    0, false};

// --- splines ---------------------------------------------------------------------------------------------------------

inline constexpr Operator<"thin_plate_points", Tensor(Tensor points, Tensor centers, Tensor weights, Tensor affine)>
    thin_plate_points{from<"thin_plate_points_backward">};
inline constexpr Operator<"thin_plate_map",
                          Tensor(Tensor centers, Tensor weights, Tensor affine, Ints size, bool align_corners)>
    thin_plate_map{from<"thin_plate_map_backward">};

// The system is symmetric, and what it multiplies is the spline at its own centers, and its weights' sums.
inline constexpr Operator<"thin_plate_weights", Tensor(Tensor centers, Tensor rhs)> thin_plate_weights{
    [](Backward const& b) -> variable_list {
      Tensor const x = b.tensor(0);
      int64_t const n = x.size(1);
      Tensor const to_right = b.call(thin_plate_weights, {{"rhs", b.grad()}})[0];
      if (!b.needs(0)) return {Tensor(), to_right};
      Tensor const both = b.call(thin_plate_weights)[0], weights = both.narrow(1, 0, n);
      variable_list const to =
          call("thin_plate_points_backward", {to_right.narrow(1, 0, n), x, x, weights, both.narrow(1, n, 3)});
      return {-(to[0] + to[1] + weights.matmul(to_right.narrow(1, n + 1, 2).mT())), to_right};
    }};

// --- registration ----------------------------------------------------------------------------------------------------

// Their gradients are saved with the loss.
inline constexpr Operator<"photometric", Two(Tensor source, Tensor target, Tensor matrix, int64_t distance, double eps,
                                             bool align_corners, bool normalized)>
    photometric{[](Backward const& b) -> variable_list {
                  Tensor const to_matrix = b.grad().view({-1, 1, 1}) * b.results[0];
                  return {Tensor(), Tensor(), detail::once("photometric", to_matrix, {b.grad(), b.tensor(2)})};
                },
                1};
inline constexpr Operator<"photometric_normal_equations",
                          Three(Tensor source, Tensor target, Tensor matrix, int64_t distance, double eps,
                                bool align_corners, bool normalized)>
    photometric_normal_equations{non_differentiable};
inline constexpr Operator<"photometric_depth", Four(Tensor views, Tensor target, Tensor depth, Tensor projections,
                                                    int64_t distance, double eps)>
    photometric_depth{[](Backward const& b) -> variable_list {
                        Tensor const& grad = b.grad();
                        variable_list const tensors{grad, b.tensor(2), b.tensor(3)};
                        Tensor const to_depth = (grad * b.results[1]).view({-1, 1, 1, 1}) * b.results[0];
                        Tensor const to_projections = grad.view({-1, 1, 1, 1}) * b.results[2];
                        return {Tensor(), Tensor(), detail::once("photometric_depth", to_depth, tensors),
                                detail::once("photometric_depth", to_projections, tensors)};
                      },
                      3};

// --- peaks -----------------------------------------------------------------------------------------------------------

inline constexpr Operator<"apply_nms_mask", Tensor(Tensor input, Tensor flags)> apply_nms_mask{
    [](Backward const& b) { return b.call(apply_nms_mask, {{"input", b.grad()}}); }, 0, false};
inline constexpr Operator<"nms_mask", Tensor(Tensor input, Ints window, bool volumes)> nms_mask{non_differentiable};
inline constexpr Operator<"nms_minmax_masks", Two(Tensor input, Ints window, bool volumes)> nms_minmax_masks{
    non_differentiable};
inline constexpr Operator<"nms", Two(Tensor input, Ints window, bool volumes, bool marked)> nms{
    [](Backward const& b) -> variable_list {
      Tensor const flags = b.results[0].numel() > 0 ? b.results[0] : b.call(nms_mask)[0];
      return {apply_nms_mask(b.grad(), flags)};
    },
    1};
inline constexpr Operator<"spatial_expectation", Two(Tensor input, bool softmax, double scale, bool normalized)>
    spatial_expectation{from<"spatial_expectation_backward", 2>};
inline constexpr Operator<"render_gaussian2d",
                          Tensor(Tensor mean, Tensor std, int64_t height, int64_t width, bool normalized)>
    render_gaussian2d{from<"render_gaussian2d_backward">};
inline constexpr Operator<"soft_argmax", Two(Tensor input, Ints window, Ints stride, Ints padding, double temperature,
                                             bool normalized, bool scale_too, bool with_values)>
    soft_argmax{from<"soft_argmax_backward">};
inline constexpr Operator<"conv_quad_interp3d", Two(Tensor input, OptionalTensor chosen, int64_t steps,
                                                    double largest_shift, int64_t radius, bool along_scale)>
    conv_quad_interp3d{from<"conv_quad_interp3d_backward">};

// --- depth -----------------------------------------------------------------------------------------------------------

namespace detail {

// Of the points of depth, from their gradient (B, 3, H, W).
inline variable_list depth_points_gradients(Backward const& b, Tensor const& grad) {
  return {b.needs(0) ? b.call("depth_points_backward", {{"grad", grad}})[0] : Tensor(),
          b.needs(1) ? b.call("depth_points_camera_backward", {{"grad", grad}})[0] : Tensor()};
}

}  // namespace detail

inline constexpr Operator<"depth_points", Tensor(Tensor depth, Tensor camera, bool distance, bool last)> depth_points{
    [](Backward const& b) -> variable_list {
      return detail::depth_points_gradients(b, b.arguments[3].toBool() ? b.grad().movedim(-1, 1) : b.grad());
    }};
inline constexpr Operator<"depth_normals", Tensor(Tensor depth, Tensor camera, bool distance)> depth_normals{
    [](Backward const& b) -> variable_list {
      if (!b.needs(1)) return b.call("depth_normals_backward");
      return detail::depth_points_gradients(b, b.call("depth_normals_points_backward")[0]);
    }};
inline constexpr Operator<"reprojection", Tensor(Tensor camera_to, Tensor pose_to, Tensor camera_from,
                                                 OptionalTensor pose_from, bool pinhole)>
    reprojection{from<"reprojection_backward">};
inline constexpr Operator<"depth_warp", Tensor(Tensor image, Tensor depth, Tensor projection, int64_t interpolation,
                                               int64_t padding, bool align_corners)>
    depth_warp{[](Backward const& b) -> variable_list {
      auto const type = b.grad().scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
      variable_list const maps = b.needs(1) || b.needs(2) ? b.call("depth_warp_coords_backward") : variable_list(2);
      return {b.needs(0)
                  ? b.call("depth_warp_image_backward", {{"grad", b.grad().to(type)}, {"size", b.image_size()}})[0]
                  : Tensor(),
              maps[0], maps[1]};
    }};

// --- points ----------------------------------------------------------------------------------------------------------

inline constexpr Operator<"transform_points", Tensor(Tensor points, OptionalTensor depth, Tensor matrix, int64_t kind)>
    transform_points{
        [](Backward const& b) { return b.call("transform_points_backward", {{"wants_matrix", b.needs(2)}}); }};
inline constexpr Operator<"undistort_map", Tensor(Tensor camera, Tensor coefficients, OptionalTensor tilt, Ints size)>
    undistort_map{from<"undistort_map_backward">};

// Python differentiates these; C++ does in kvision::undistort_points and distort_points.
inline constexpr Operator<"distort_points", Tensor(Tensor points, Tensor camera, Tensor new_camera, Tensor coefficients,
                                                   OptionalTensor tilt)>
    distort_points;
inline constexpr Operator<"undistort_points", Tensor(Tensor points, Tensor camera, Tensor new_camera,
                                                     Tensor coefficients, OptionalTensor tilt, int64_t steps)>
    undistort_points;

// --- least squares ---------------------------------------------------------------------------------------------------

inline constexpr Operator<"null_vector", Tensor(Tensor rows, OptionalTensor weights)> null_vector{
    from<"null_vector_backward", 1>};
inline constexpr Operator<"homography_dlt", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)>
    homography_dlt{from<"homography_dlt_backward">};
inline constexpr Operator<"homography_lines_dlt", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)>
    homography_lines_dlt{from<"homography_lines_dlt_backward">};
inline constexpr Operator<"fundamental_dlt", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)>
    fundamental_dlt{from<"fundamental_dlt_backward">};
inline constexpr Operator<"affine_fit", Tensor(Tensor points1, Tensor points2, OptionalTensor weights)> affine_fit{
    from<"affine_fit_backward">};
inline constexpr Operator<"pose_dlt",
                          Tensor(Tensor points, Tensor pixels, Tensor camera, OptionalTensor weights, double flat)>
    pose_dlt{from<"pose_dlt_backward">};
inline constexpr Operator<"normalize_points", Two(Tensor points, OptionalTensor weights, double eps)> normalize_points{
    from<"normalize_points_backward">};
inline constexpr Operator<"triangulate",
                          Tensor(Tensor points1, Tensor points2, Tensor projections1, Tensor projections2)>
    triangulate{from<"triangulate_backward">};

// --- two views -------------------------------------------------------------------------------------------------------

inline constexpr Operator<"nearest_essential", Tensor(Tensor matrix)> nearest_essential{
    from<"nearest_essential_backward">};
inline constexpr Operator<"essential_motions", Two(Tensor matrix)> essential_motions{
    from<"essential_motions_backward">};
inline constexpr Operator<"motion_choice", Five(Tensor matrix, Tensor camera1, Tensor camera2, Tensor points1,
                                                Tensor points2, OptionalTensor mask)>
    motion_choice;
inline constexpr Operator<"correspondence_errors",
                          Tensor(Tensor points1, Tensor points2, Tensor matrix, int64_t kind, bool squared)>
    correspondence_errors{from<"correspondence_errors_backward">};

// --- RANSAC: models and their inliers --------------------------------------------------------------------------------

inline constexpr Operator<"minimal_solver", Tensor(Tensor points1, Tensor points2, OptionalTensor draws, int64_t model)>
    minimal_solver;
inline constexpr Operator<"consensus",
                          Tensor(Tensor models, Tensor points1, Tensor points2, double threshold, int64_t model)>
    consensus{non_differentiable};
inline constexpr Operator<"top_k_models", Two(Tensor models, Tensor scores, int64_t count, bool by_count)> top_k_models{
    non_differentiable};
inline constexpr Operator<"finalize_model", Two(Tensor models, Tensor weights, int64_t min_inliers, int64_t model)>
    finalize_model{non_differentiable};
inline constexpr Operator<"merge_top_k", Three(Tensor models, Tensor scores, Tensor other_models, Tensor other_scores,
                                               Tensor points1, Tensor points2, double threshold, double softness,
                                               int64_t count, bool by_count, int64_t model)>
    merge_top_k{non_differentiable};
inline constexpr Operator<"eigenvectors", Two(Tensor matrix)> eigenvectors{non_differentiable};
inline constexpr Operator<"real_roots", Tensor(Tensor coefficients)> real_roots;
inline constexpr Operator<"first_root", Tensor(Tensor coefficients)> first_root;

// --- formulas of rotations, poses and matrices -----------------------------------------------------------------------

inline constexpr Operator<"axis_angle_to_rotation_matrix", Tensor(Tensor axis_angle)> axis_angle_to_rotation_matrix{
    side_by_side};
inline constexpr Operator<"quaternion_exponential", Tensor(Tensor vector, double part)> quaternion_exponential{
    side_by_side};
inline constexpr Operator<"quaternion_to_axis_angle", Tensor(Tensor quaternion)> quaternion_to_axis_angle{side_by_side};
inline constexpr Operator<"quaternion_logarithm", Tensor(Tensor quaternion)> quaternion_logarithm{side_by_side};
inline constexpr Operator<"quaternion_product", Tensor(Tensor left, Tensor right)> quaternion_product{side_by_side};
inline constexpr Operator<"normalize_quaternion", Tensor(Tensor quaternion, double eps)> normalize_quaternion{
    side_by_side};
inline constexpr Operator<"quaternion_to_rotation_matrix", Tensor(Tensor quaternion)> quaternion_to_rotation_matrix{
    side_by_side};
inline constexpr Operator<"rotation_matrix_to_quaternion", Tensor(Tensor matrix)> rotation_matrix_to_quaternion{
    side_by_side};
inline constexpr Operator<"cross_matrix", Tensor(Tensor vector)> cross_matrix{side_by_side};
inline constexpr Operator<"compose_poses", Tensor(Tensor first, Tensor second)> compose_poses{side_by_side};
inline constexpr Operator<"invert_pose", Tensor(Tensor pose)> invert_pose{side_by_side};
inline constexpr Operator<"relative_pose", Tensor(Tensor first, Tensor second)> relative_pose{side_by_side};
inline constexpr Operator<"rotation_matrix_to_axis_angle", Tensor(Tensor matrix)> rotation_matrix_to_axis_angle{
    side_by_side};
inline constexpr Operator<"angle_to_rotation_matrix", Tensor(Tensor degrees)> angle_to_rotation_matrix{side_by_side};
inline constexpr Operator<"quaternion_from_euler", Tensor(Tensor roll, Tensor pitch, Tensor yaw)> quaternion_from_euler{
    side_by_side};
inline constexpr Operator<"euler_from_quaternion", Tensor(Tensor w, Tensor x, Tensor y, Tensor z)>
    euler_from_quaternion{side_by_side};
inline constexpr Operator<"affine_matrix2d",
                          Tensor(Tensor degrees, OptionalTensor translation, OptionalTensor scale,
                                 OptionalTensor shear_x, OptionalTensor shear_y, OptionalTensor center, double sign,
                                 double x, double y, int64_t rows)>
    affine_matrix2d{side_by_side};
inline constexpr Operator<"translation_matrix2d", Tensor(Tensor translation, double x, double y, int64_t rows)>
    translation_matrix2d{side_by_side};
inline constexpr Operator<"translation_matrix3d",
                          Tensor(Tensor translation, double x, double y, double z, int64_t rows)>
    translation_matrix3d{side_by_side};
inline constexpr Operator<"scale_matrix2d", Tensor(Tensor scale, OptionalTensor center, double x, double y)>
    scale_matrix2d{side_by_side};
inline constexpr Operator<"shear_matrix2d", Tensor(Tensor center, OptionalTensor shear_x, OptionalTensor shear_y)>
    shear_matrix2d{side_by_side};
inline constexpr Operator<"shear_factor_matrix2d", Tensor(Tensor factors)> shear_factor_matrix2d{side_by_side};
inline constexpr Operator<"invert_affine2d", Tensor(Tensor matrix)> invert_affine2d{side_by_side};
inline constexpr Operator<"affine_matrix3d",
                          Tensor(Tensor x, Tensor y, Tensor z, OptionalTensor translation, OptionalTensor scale,
                                 OptionalTensor center, OptionalTensor xy, OptionalTensor xz, OptionalTensor yx,
                                 OptionalTensor yz, OptionalTensor zx, OptionalTensor zy, double sign, double center_x,
                                 double center_y, double center_z, int64_t rows)>
    affine_matrix3d{side_by_side};
inline constexpr Operator<"shear_matrix3d",
                          Tensor(Tensor center, OptionalTensor xy, OptionalTensor xz, OptionalTensor yx,
                                 OptionalTensor yz, OptionalTensor zx, OptionalTensor zy)>
    shear_matrix3d{side_by_side};
inline constexpr Operator<"perspective_matrix", Tensor(Tensor points_src, Tensor points_dst)> perspective_matrix{
    side_by_side};
inline constexpr Operator<"perspective_matrix3d",
                          Tensor(Tensor points_src, OptionalTensor points_dst, double x, double y, double z)>
    perspective_matrix3d{side_by_side};
inline constexpr Operator<"crop_matrix", Tensor(Tensor quads, OptionalTensor first, double across, double down)>
    crop_matrix{side_by_side};
inline constexpr Operator<"crop_box_checks", Tensor(Tensor quads, Tensor others)> crop_box_checks{side_by_side};
inline constexpr Operator<"essential_from_fundamental", Tensor(Tensor fundamental, Tensor camera1, Tensor camera2)>
    essential_from_fundamental{side_by_side};
inline constexpr Operator<"fundamental_from_essential", Tensor(Tensor essential, Tensor camera1, Tensor camera2)>
    fundamental_from_essential{side_by_side};
inline constexpr Operator<"fundamental_from_projections", Tensor(Tensor projection1, Tensor projection2)>
    fundamental_from_projections{side_by_side};
inline constexpr Operator<"normalize_line", Tensor(Tensor line)> normalize_line{side_by_side};
inline constexpr Operator<"camera_motion",
                          Tensor(Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2)>
    camera_motion{side_by_side};
inline constexpr Operator<"decompose_projection", Tensor(Tensor projection)> decompose_projection{side_by_side};
inline constexpr Operator<"product_of_linear", Tensor(Tensor a, Tensor b)> product_of_linear{side_by_side};
inline constexpr Operator<"product_of_quadratic", Tensor(Tensor a, Tensor b)> product_of_quadratic{side_by_side};
inline constexpr Operator<"determinant_to_polynomial", Tensor(Tensor A)> determinant_to_polynomial{side_by_side};

// --- Lie groups

inline constexpr Operator<"se2_exp", Tensor(Tensor tangent)> se2_exp{side_by_side};
inline constexpr Operator<"se2_log", Tensor(Tensor motion)> se2_log{side_by_side};
inline constexpr Operator<"so3_left_jacobian", Tensor(Tensor tangent)> so3_left_jacobian{side_by_side};
inline constexpr Operator<"so3_left_jacobian_inverse", Tensor(Tensor tangent)> so3_left_jacobian_inverse{side_by_side};
inline constexpr Operator<"se3_exp", Tensor(Tensor tangent)> se3_exp{side_by_side};
inline constexpr Operator<"se3_log", Tensor(Tensor motion)> se3_log{side_by_side};
inline constexpr Operator<"se3_left_jacobian", Tensor(Tensor tangent)> se3_left_jacobian{side_by_side};
inline constexpr Operator<"se3_left_jacobian_inverse", Tensor(Tensor tangent)> se3_left_jacobian_inverse{side_by_side};
inline constexpr Operator<"essential_from_motions",
                          Tensor(Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2)>
    essential_from_motions{side_by_side};

}  // namespace kvision::ops
