// Warps, resizing and matrices of images (B, C, H, W) and volumes (B, C, D, H, W), as python/kvision/geometry/transform
// has them. Matrices are (B or 1, ...) in any floating-point type. A second derivative of a warp is an error.
#pragma once

#include "kvision/ops/filters.h"
#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

struct TransformOptions {
  TORCH_ARG(Interpolation, mode) = Interpolation::bilinear;   // or nearest, bicubic
  TORCH_ARG(PaddingMode, padding_mode) = PaddingMode::zeros;  // or border, reflection
  TORCH_ARG(bool, align_corners) = true;
};

struct WarpOptions {
  TORCH_ARG(Interpolation, mode) = Interpolation::bilinear;   // or nearest, bicubic
  TORCH_ARG(PaddingMode, padding_mode) = PaddingMode::zeros;  // or border, reflection, fill
  TORCH_ARG(bool, align_corners) = true;
  TORCH_ARG(std::optional<Tensor>, fill_value);  // (C,) or (B or 1, C or 1), for padding_mode fill
};

struct RemapOptions {
  TORCH_ARG(Interpolation, mode) = Interpolation::bilinear;
  TORCH_ARG(PaddingMode, padding_mode) = PaddingMode::zeros;
  TORCH_ARG(bool, align_corners) = false;
  TORCH_ARG(bool, normalized_coordinates) = false;
};

struct HomographyWarpOptions {
  TORCH_ARG(Interpolation, mode) = Interpolation::bilinear;
  TORCH_ARG(PaddingMode, padding_mode) = PaddingMode::zeros;
  TORCH_ARG(bool, align_corners) = false;
  TORCH_ARG(bool, normalized_coordinates) = true;
};

namespace detail {

inline Tensor warp(char const* op, Tensor const& src, Tensor const& M, int64_t rows, Size2d dsize,
                   WarpOptions const& options, bool inverse, bool normalized) {
  images(op, "src", src);
  TORCH_CHECK_VALUE(M.dim() == 3 && M.size(1) == rows && M.size(2) == 3, op, ": expected M of shape (B or 1, ", rows,
                    ", 3), got ", M.sizes());
  auto fill = computed(options.fill_value(), src);
  TORCH_CHECK_VALUE(!fill || options.padding_mode() == PaddingMode::fill, op,
                    ": expected a fill_value with padding_mode fill only");
  if (fill && fill->dim() < 2) fill = fill->reshape({1, -1});
  return ops::warp(src, computed(M, src), fill, {}, list(dsize), int64_t(options.mode()),
                   detail::padding_number(options.padding_mode()), options.align_corners(), inverse, normalized);
}

inline Tensor warp_by_formula(char const* op, Tensor const& tensor, ops::WarpFormula formula,
                              std::vector<double> const& numbers, std::vector<std::optional<Tensor>> tensors,
                              std::vector<int64_t> const& size, TransformOptions const& options, bool inverse = true,
                              std::optional<Tensor> const& image_index = {}) {
  tensors.resize(6);
  for (auto& x : tensors) x = computed(x, tensor);
  auto const run = [&](auto const& by_formula, auto const&... index) {
    return by_formula(tensor, tensors[0], tensors[1], tensors[2], tensors[3], tensors[4], tensors[5], index...,
                      int64_t(formula), numbers, size, int64_t(options.mode()),
                      detail::padding_number(options.padding_mode()), options.align_corners(), inverse, false);
  };
  if (size.size() == 3) return volumes(op, "tensor", tensor), run(ops::warp3d_by_formula);
  return images(op, "tensor", tensor), run(ops::warp_by_formula, image_index);
}

// The middle of an image, x before y.
inline std::vector<double> middle(Tensor const& image, std::vector<double> numbers = {}) {
  for (int64_t axis = image.dim() - 1; axis >= 2; --axis) numbers.push_back((image.size(axis) - 1) / 2.0);
  return numbers;
}

}  // namespace detail

// --- warps

// M maps pixels (x, y, 1) of src to those of the result.
inline Tensor warp_affine(Tensor const& src, Tensor const& M, Size2d dsize, WarpOptions const& options = {}) {
  return detail::warp("warp_affine", src, M, 2, dsize, options, true, false);
}
inline Tensor warp_perspective(Tensor const& src, Tensor const& M, Size2d dsize, WarpOptions const& options = {}) {
  return detail::warp("warp_perspective", src, M, 3, dsize, options, true, false);
}
// src_homo_dst maps coordinates of the result, in [-1, 1] if normalized, to those of patch_src.
inline Tensor homography_warp(Tensor const& patch_src, Tensor const& src_homo_dst, Size2d dsize,
                              HomographyWarpOptions const& options = {}) {
  auto const warp =
      WarpOptions().mode(options.mode()).padding_mode(options.padding_mode()).align_corners(options.align_corners());
  return detail::warp("homography_warp", patch_src, src_homo_dst, 3, dsize, warp, false,
                      options.normalized_coordinates());
}

// Resamples an image at the coordinates in map_x and map_y (B or 1, h, w), in pixels or in [-1, 1].
inline Tensor remap(Tensor const& image, Tensor const& map_x, Tensor const& map_y, RemapOptions const& options = {}) {
  detail::images("remap", "image", image);
  detail::same_shape("remap", "map_y", map_y, detail::shaped("remap", "map_x", map_x, 3, "(B or 1, h, w)"));
  return ops::remap(image, detail::computed(map_x, image), detail::computed(map_y, image), {}, {},
                    int64_t(options.mode()), detail::padding_number(options.padding_mode()), options.align_corners(),
                    options.normalized_coordinates(), false);
}

inline Tensor affine(Tensor const& tensor, Tensor const& matrix, TransformOptions const& options = {}) {
  auto const warp =
      WarpOptions().mode(options.mode()).padding_mode(options.padding_mode()).align_corners(options.align_corners());
  return detail::warp("affine", tensor, matrix, 2, detail::image_size(tensor), warp, true, false);
}
// Counterclockwise by degrees (B or 1,), about a center (B or 1, 2) or the middle.
inline Tensor rotate(Tensor const& tensor, Tensor const& angle, std::optional<Tensor> const& center = {},
                     TransformOptions const& options = {}) {
  return detail::warp_by_formula("rotate", tensor, ops::WarpFormula::affine_matrix2d, detail::middle(tensor, {1}),
                                 {angle, {}, {}, {}, {}, center}, detail::image_size(tensor), options);
}
inline Tensor translate(Tensor const& tensor, Tensor const& translation, TransformOptions const& options = {}) {
  return detail::warp_by_formula("translate", tensor, ops::WarpFormula::translation_matrix2d, {0, 0}, {translation},
                                 detail::image_size(tensor), options);
}
// By factors (B or 1, 2) along x and y.
inline Tensor scale(Tensor const& tensor, Tensor const& scale_factor, std::optional<Tensor> const& center = {},
                    TransformOptions const& options = {}) {
  return detail::warp_by_formula("scale", tensor, ops::WarpFormula::scale_matrix2d, detail::middle(tensor),
                                 {scale_factor, center}, detail::image_size(tensor), options);
}
inline Tensor shear(Tensor const& tensor, Tensor const& shear,
                    TransformOptions const& options = TransformOptions().align_corners(false)) {
  return detail::warp_by_formula("shear", tensor, ops::WarpFormula::shear_factor_matrix2d, {}, {shear},
                                 detail::image_size(tensor), options);
}
// The quadrangles (N, 4, 2) of images, from the upper left corner clockwise, as images of a size: one of each image,
// all of a single one, or of the image that box_indices (N,) says.
inline Tensor crop_and_resize(Tensor const& input_tensor, Tensor const& boxes, Size2d size,
                              TransformOptions const& options = {}, std::optional<Tensor> const& box_indices = {}) {
  auto const extent = [&](int i) { return double(std::max<int64_t>(size->at(i) - 1, 1)); };
  return detail::warp_by_formula("crop_and_resize", input_tensor, ops::WarpFormula::crop_matrix, {extent(1), extent(0)},
                                 {boxes}, detail::list(size), options, false, box_indices);
}
inline Tensor center_crop(Tensor const& input_tensor, Size2d size, TransformOptions const& options = {}) {
  detail::images("center_crop", "input_tensor", input_tensor);
  int64_t const y = input_tensor.size(2) - size->at(0), x = input_tensor.size(3) - size->at(1);
  if (y % 2 == 0 && x % 2 == 0) return ops::crop(input_tensor, {y / 2, x / 2}, detail::list(size));
  return detail::warp_by_formula("center_crop", input_tensor, ops::WarpFormula::translation_matrix2d,
                                 {x / 2.0, y / 2.0}, {}, detail::list(size), options, false);
}

inline Tensor hflip(Tensor const& input) { return ops::flip(detail::images("hflip", "input", input), true, false); }
inline Tensor vflip(Tensor const& input) { return ops::flip(detail::images("vflip", "input", input), false, true); }
inline Tensor rot180(Tensor const& input) { return ops::flip(detail::images("rot180", "input", input), true, true); }

namespace detail {

inline Tensor warp3d(char const* op, Tensor const& src, Tensor const& M, Size3d dsize, TransformOptions const& options,
                     bool inverse, bool normalized) {
  Tensor const x = floats(volumes(op, "src", src));
  return ops::warp3d(x, computed(shaped(op, "M", M, 3, "(B or 1, 3 or 4, 4)"), x), list(dsize), int64_t(options.mode()),
                     detail::padding_number(options.padding_mode()), options.align_corners(), inverse, normalized);
}

}  // namespace detail

inline Tensor warp_affine3d(Tensor const& src, Tensor const& M, Size3d dsize, TransformOptions const& options = {}) {
  return detail::warp3d("warp_affine3d", src, M, dsize, options, true, false);
}
inline Tensor warp_perspective3d(Tensor const& src, Tensor const& M, Size3d dsize,
                                 TransformOptions const& options = TransformOptions().align_corners(false)) {
  return detail::warp3d("warp_perspective3d", src, M, dsize, options, true, false);
}
inline Tensor homography_warp3d(Tensor const& patch_src, Tensor const& src_homo_dst, Size3d dsize,
                                HomographyWarpOptions const& options = {}) {
  auto const warp = TransformOptions()
                        .mode(options.mode())
                        .padding_mode(options.padding_mode())
                        .align_corners(options.align_corners());
  return detail::warp3d("homography_warp3d", patch_src, src_homo_dst, dsize, warp, false,
                        options.normalized_coordinates());
}
// By angles (B,) in degrees.
inline Tensor rotate3d(Tensor const& tensor, Tensor const& yaw, Tensor const& pitch, Tensor const& roll,
                       std::optional<Tensor> const& center = {},
                       TransformOptions const& options = TransformOptions().align_corners(false)) {
  return detail::warp_by_formula("rotate3d", tensor, ops::WarpFormula::affine_matrix3d, detail::middle(tensor, {1}),
                                 {yaw, pitch, roll, {}, {}, center}, detail::image_size(tensor), options);
}

// --- resizing

struct ResizeOptions {
  TORCH_ARG(Interpolation, interpolation) = Interpolation::bilinear;
  TORCH_ARG(bool, align_corners) = false;
  TORCH_ARG(bool, antialias) = false;  // a Gaussian blur before the image shrinks
};

inline Tensor resize(Tensor const& input, Size2d size, ResizeOptions const& options = {}) {
  Tensor x = detail::images("resize", "input", input);
  double const y_factor = double(x.size(2)) / size->at(0), x_factor = double(x.size(3)) / size->at(1);
  if (options.antialias() && std::max(y_factor, x_factor) > 1) {
    auto const sigma = [](double factor) { return std::max((factor - 1) / 2, 0.001); };
    auto const taps = [&](double factor, int64_t n) {
      return n > 1 ? int64_t(std::max(4 * sigma(factor), 3.0)) / 2 * 2 + 1 : 1;
    };
    x = ops::gaussian_blur2d(detail::computed(x, x), {}, taps(y_factor, x.size(2)), taps(x_factor, x.size(3)),
                             sigma(y_factor), sigma(x_factor), int64_t(BorderType::reflect));
  }
  return ops::resize(x, detail::list(size), int64_t(options.interpolation()), options.align_corners(), false,
                     int64_t(BorderType::replicate))
      .to(input.scalar_type());
}
inline Tensor rescale(Tensor const& input, Pair factor, ResizeOptions const& options = {}) {
  detail::images("rescale", "input", input);
  return resize(input, {int64_t(input.size(2) * factor->at(0)), int64_t(input.size(3) * factor->at(1))}, options);
}

// Half and twice as large, with the Gaussian kernel of 5 x 5 of image pyramids.
inline Tensor pyrdown(Tensor const& input, BorderType border_type = BorderType::reflect, bool align_corners = false) {
  detail::images("pyrdown", "input", input);
  return ops::resize(input, {input.size(2) / 2, input.size(3) / 2}, ops::kPyrDown, align_corners, false,
                     int64_t(border_type));
}
inline Tensor pyrup(Tensor const& input, BorderType border_type = BorderType::reflect, bool align_corners = false) {
  detail::images("pyrup", "input", input);
  return ops::resize(input, {2 * input.size(2), 2 * input.size(3)}, ops::kPyrUp, align_corners, false,
                     int64_t(border_type));
}
inline std::vector<Tensor> build_pyramid(Tensor const& input, int64_t max_level,
                                         BorderType border_type = BorderType::reflect, bool align_corners = false) {
  std::vector<Tensor> levels{input};
  while (int64_t(levels.size()) < max_level) levels.push_back(pyrdown(levels.back(), border_type, align_corners));
  return levels;
}
// The details that each level has and the next one has not, then the last level; sides are multiples of 2^max_level.
inline std::vector<Tensor> build_laplacian_pyramid(Tensor const& input, int64_t max_level,
                                                   BorderType border_type = BorderType::reflect,
                                                   bool align_corners = false) {
  detail::images("build_laplacian_pyramid", "input", input);
  TORCH_CHECK_VALUE(input.size(2) % (1 << max_level) == 0 && input.size(3) % (1 << max_level) == 0,
                    "build_laplacian_pyramid: expected sides that are multiples of ", 1 << max_level, ", got ",
                    input.sizes());
  std::vector<Tensor> levels = build_pyramid(detail::floats(input), max_level + 1, border_type, align_corners);
  for (int64_t i = 0; i < max_level; ++i)
    levels[i] = ops::pyramid_detail(levels[i + 1], levels[i], align_corners, int64_t(border_type));
  return levels;
}

// --- displacements and splines

struct ElasticTransformOptions {
  TORCH_ARG(Size2d, kernel_size) = 63;
  TORCH_ARG(Sigma, sigma) = 32;
  TORCH_ARG(Pair, alpha) = 1;  // x before y
  TORCH_ARG(bool, align_corners) = false;
  TORCH_ARG(Interpolation, mode) = Interpolation::bilinear;
  TORCH_ARG(PaddingMode, padding_mode) = PaddingMode::zeros;
};
// Moves pixels by blurred noise (B or 1, 2, H, W).
inline Tensor elastic_transform2d(Tensor const& image, Tensor const& noise,
                                  ElasticTransformOptions const& options = {}) {
  detail::images("elastic_transform2d", "noise", noise);
  detail::images("elastic_transform2d", "image", image);
  auto const& sigma = options.sigma();
  Tensor const blurred = ops::gaussian_blur2d(detail::computed(noise, image), detail::computed(sigma.tensor, image),
                                              options.kernel_size()->at(0), options.kernel_size()->at(1), sigma.y,
                                              sigma.x, int64_t(BorderType::constant));
  return ops::remap(image, blurred.select(1, 0) * options.alpha()->at(0), blurred.select(1, 1) * options.alpha()->at(1),
                    {}, {}, int64_t(options.mode()), detail::padding_number(options.padding_mode()),
                    options.align_corners(), true, true);
}

// The weights (B, N, 2) and the affine part (B, 3, 2) of splines that take points (B, N, 2) to others.
inline std::tuple<Tensor, Tensor> get_tps_transform(Tensor const& points_src, Tensor const& points_dst) {
  detail::shaped("get_tps_transform", "points_src", points_src, 3, "(B, N, 2)");
  detail::shaped("get_tps_transform", "points_dst", points_dst, 3, "(B, N, 2)");
  int64_t const n = points_src.size(1);
  Tensor const both = ops::thin_plate_weights(points_src, at::constant_pad_nd(points_dst, {0, 0, 0, 3}));
  return {both.narrow(1, 0, n), both.narrow(1, n, 3)};
}
inline Tensor warp_points_tps(Tensor const& points_src, Tensor const& kernel_centers, Tensor const& kernel_weights,
                              Tensor const& affine_weights) {
  return ops::thin_plate_points(detail::shaped("warp_points_tps", "points_src", points_src, 3, "(B, N, 2)"),
                                kernel_centers, kernel_weights, affine_weights);
}
inline Tensor warp_image_tps(Tensor const& image, Tensor const& kernel_centers, Tensor const& kernel_weights,
                             Tensor const& affine_weights, bool align_corners = false,
                             PaddingMode padding_mode = PaddingMode::zeros) {
  detail::images("warp_image_tps", "image", image);
  Tensor const map =
      ops::thin_plate_map(detail::computed(kernel_centers, image), detail::computed(kernel_weights, image),
                          detail::computed(affine_weights, image), detail::image_size(image), align_corners);
  return ops::remap(image, map.select(1, 0), map.select(1, 1), {}, {}, int64_t(Interpolation::bilinear),
                    detail::padding_number(padding_mode), align_corners, true, false);
}

// --- matrices, of one type and B or 1

inline Tensor get_rotation_matrix2d(Tensor const& center, Tensor const& angle, Tensor const& scale) {
  return ops::affine_matrix2d(angle, {}, scale, {}, {}, center, 1, 0, 0, 2);
}
inline Tensor get_translation_matrix2d(Tensor const& translations) {
  return ops::translation_matrix2d(translations, 0, 0, 3);
}
inline Tensor get_shear_matrix2d(Tensor const& center, std::optional<Tensor> const& sx = {},
                                 std::optional<Tensor> const& sy = {}) {
  return ops::shear_matrix2d(center, sx, sy);
}
inline Tensor get_affine_matrix2d(Tensor const& translations, Tensor const& center, Tensor const& scale,
                                  Tensor const& angle, std::optional<Tensor> const& sx = {},
                                  std::optional<Tensor> const& sy = {}) {
  return ops::affine_matrix2d(angle, translations, scale, sx, sy, center, -1, 0, 0, 3);
}
inline Tensor invert_affine_transform(Tensor const& matrix) { return ops::invert_affine2d(matrix); }
inline Tensor get_perspective_transform(Tensor const& points_src, Tensor const& points_dst) {
  return ops::perspective_matrix(points_src, points_dst);
}
inline Tensor get_perspective_transform3d(Tensor const& src, Tensor const& dst) {
  return ops::perspective_matrix3d(src, dst, 0, 0, 0);
}
inline Tensor get_projective_transform(Tensor const& center, Tensor const& angles, Tensor const& scales) {
  return ops::affine_matrix3d(angles.select(1, 0), angles.select(1, 1), angles.select(1, 2), {}, scales, center, {}, {},
                              {}, {}, {}, {}, 1, 0, 0, 0, 3);
}

// --- registration

struct PhotometricOptions {
  TORCH_ARG(Distance, distance) = Distance::l1;
  TORCH_ARG(double, eps) = 1e-3;
  TORCH_ARG(bool, align_corners) = false;
  TORCH_ARG(bool, normalized_coordinates) = true;
};
// The mean distance (B,) of `target` from `source` warped by a homography; the gradient is to the homography.
inline Tensor photometric_homography_loss(Tensor const& source, Tensor const& target, Tensor const& src_homo_dst,
                                          PhotometricOptions const& options = {}) {
  detail::images("photometric_homography_loss", "source", source);
  return std::get<0>(ops::photometric(source, target, detail::computed(src_homo_dst, source),
                                      int64_t(options.distance()), options.eps(), options.align_corners(),
                                      options.normalized_coordinates()));
}
// The normal equations (B, 8, 8), the gradient (B, 8) and the distance (B) of a Gauss-Newton step.
inline std::tuple<Tensor, Tensor, Tensor> photometric_normal_equations(Tensor const& source, Tensor const& target,
                                                                       Tensor const& src_homo_dst,
                                                                       PhotometricOptions const& options = {}) {
  detail::images("photometric_normal_equations", "source", source);
  return ops::photometric_normal_equations(source, target, detail::computed(src_homo_dst, source),
                                           int64_t(options.distance()), options.eps(), options.align_corners(),
                                           options.normalized_coordinates());
}

}  // namespace kvision
