// The numbers of modes, which never change. Written by tools/generate.py from the declarations in csrc that it names.
#pragma once

#include <cstdint>

namespace kvision {

enum class BorderType { constant = 0, reflect = 1, replicate = 2, circular = 3 };
enum class DerivativeMode { sobel = 0, diff = 1 };
enum class Interpolation { nearest = 0, nearest_exact = 1, area = 2, bilinear = 3, bicubic = 4, lanczos = 5 };
enum class Distance { l1 = 0, l2 = 1, charbonnier = 2 };

inline constexpr double kLuma[] = {0.299, 0.587, 0.114};  // ITU-R BT.601

namespace ops {

enum class WarpFormula : int64_t {
  affine_matrix2d = 1,
  translation_matrix2d = 2,
  scale_matrix2d = 3,
  shear_factor_matrix2d = 4,
  crop_matrix = 5,
  affine_matrix3d = 6,
  translation_matrix3d = 7,
  perspective_matrix3d = 8
};
enum class PointMap : int64_t { transform = 0, project = 1, unproject = 2, unproject_distance = 3, intersect = 4 };
enum class Model : int64_t { affine = 0, homography = 1, lines = 2, fundamental = 3, fundamental8 = 4, essential = 5 };
enum class CorrespondenceError : int64_t {
  sampson = 0,
  symmetrical = 1,
  right = 2,
  left = 3,
  transfer = 4,
  symmetric_transfer = 5,
  sampson_transfer = 6,
  segments = 7
};
enum class TransformKind : int64_t { affine = 0, perspective = 1, crop = 2, matrix = 3 };
// Filters of resize beside those of Interpolation.
inline constexpr int64_t kPyrDown = 6, kPyrUp = 7;

}  // namespace ops

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

}  // namespace detail
}  // namespace kvision

// The members of ColorProgram::Step in color.h.
#define KVISION_COLOR_STEPS                                                                                         \
  affine = 0, rgb_to_hsv = 1, hsv_to_rgb = 2, rgb_to_hls = 3, hls_to_rgb = 4, rgb_to_linear_rgb = 5,                \
  linear_rgb_to_rgb = 6, rgb_to_lab = 7, lab_to_rgb = 8, rgb_to_luv = 9, luv_to_rgb = 10, luma_u8_fixed_point = 11, \
  hsv_u8 = 12, weighted_sum = 13, luma_u8 = 14, scale_shift_rgb = 15, standardize_rgb = 16, saturation = 17,        \
  saturation_raw = 18, saturation_gray = 19, hue = 20, hue_raw = 21, contrast = 22, scale_shift = 23,               \
  standardize = 24, gamma = 25, log = 26, sigmoid = 27, solarize = 28, posterize = 29, threshold = 30,              \
  lightness_raw = 31
