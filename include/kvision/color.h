// Conversions of RGB images (B, 3, H, W) between color spaces, as python/kvision/color has them, and color programs,
// chains of per-pixel steps in one pass over the image. A second derivative is an error.
#pragma once

#include "kvision/ops/color.h"
#include "kvision/types.h"

namespace kvision {

// The steps and all their parameters as `numbers`. Those that are tensors stand in `parameters`, at most six, (B or 1,
// C or 1, P) of floating-point numbers; `columns` has their positions, counted along the last axes of all tensors, and
// -1 for numbers. `order` (B or 1, S) of int64 has the step of each position, or -1 for none. The result has the dtype
// and the layout, "NCHW" or "NHWC", that are asked for; bytes are 255ths.
struct ColorProgram {
  // With their parameters, as csrc/color/step_list.h explains them.
  enum Step : int64_t { KVISION_COLOR_STEPS };
  std::vector<int64_t> steps;
  std::vector<double> numbers;
  std::vector<int64_t> columns = {};
  std::vector<Tensor> parameters = {};
  std::optional<Tensor> order = {};
  std::optional<at::ScalarType> dtype = {};
  std::string layout = "same";
};
#undef KVISION_COLOR_STEPS

namespace detail {

// What plans begin with: the dtype and the layout of the result.
inline std::vector<int64_t> program_head(ColorProgram const& p) {
  constexpr at::ScalarType types[] = {at::kByte, at::kHalf, at::kBFloat16, at::kFloat, at::kDouble};
  int64_t const type = p.dtype ? std::find(std::begin(types), std::end(types), *p.dtype) - types : -1;
  TORCH_CHECK_VALUE(type < 5, "ColorProgram: expected dtype uint8 or a floating-point one, got ", *p.dtype);
  return {type, p.layout == "same" ? -1 : p.layout == "NHWC"};
}

template <class Operator>
auto run(Operator const& op, Tensor const& image, ColorProgram const& p) {
  TORCH_CHECK_VALUE(p.parameters.size() <= 6, "ColorProgram: expected at most 6 parameters, got ", p.parameters.size());
  std::vector<int64_t> plan = program_head(p);
  plan.push_back(int64_t(p.steps.size()));
  plan.insert(plan.end(), p.steps.begin(), p.steps.end());
  plan.insert(plan.end(), p.columns.begin(), p.columns.end());
  auto const parameter = [&](size_t i) {
    return i < p.parameters.size() ? std::optional(p.parameters[i]) : std::nullopt;
  };
  return op(image, parameter(0), parameter(1), parameter(2), parameter(3), parameter(4), parameter(5), p.order, plan,
            p.numbers);
}

inline Tensor converted(char const* op, Tensor const& image, ColorProgram::Step step,
                        std::vector<double> numbers = {}) {
  return run(ops::color_program, floats(colors(op, "image", image)), {{step}, std::move(numbers)});
}

// RGB images in floating point; bytes are 255ths.
inline Tensor units(Tensor const& image) {
  return image.scalar_type() == at::kByte ? image.to(at::kFloat) / 255 : floats(image);
}

// OpenCV's 8-bit codes of a color space are its values times `scale` plus `offset`, rounded and saturated.
struct Codes {
  std::array<double, 3> scale, offset;
};

// Whether the call takes and gives OpenCV's codes, which are bytes.
inline bool are_codes(char const* op, Tensor const& image, bool opencv) {
  TORCH_CHECK_TYPE(!opencv || image.scalar_type() == at::kByte, op, ": expected image to be uint8 with opencv, got ",
                   image.scalar_type());
  return opencv;
}
inline Tensor from_rgb(char const* op, Tensor const& image, ColorProgram::Step step, std::vector<double> numbers,
                       Codes const& codes, bool opencv) {
  if (!are_codes(op, colors(op, "image", image), opencv)) return converted(op, units(image), step, std::move(numbers));
  for (double scale : codes.scale) numbers.push_back(scale / 255);
  for (double offset : codes.offset) numbers.push_back(offset / 255);
  numbers.push_back(0);  // not clipped
  return run(ops::color_program, image, {{step, ColorProgram::scale_shift_rgb}, std::move(numbers)});
}
inline Tensor to_rgb(char const* op, Tensor const& image, ColorProgram::Step step, std::vector<double> const& numbers,
                     Codes const& codes, bool opencv) {
  if (!are_codes(op, colors(op, "image", image), opencv)) {
    TORCH_CHECK_TYPE(image.scalar_type() != at::kByte, op,
                     ": expected image to be floating point, or opencv=true for 8-bit codes, got Byte");
    return converted(op, image, step, numbers);
  }
  std::vector<double> of_codes;
  for (double scale : codes.scale) of_codes.push_back(255 / scale);
  for (int c = 0; c < 3; ++c) of_codes.push_back(-codes.offset[c] / codes.scale[c]);
  of_codes.push_back(0);
  of_codes.insert(of_codes.end(), numbers.begin(), numbers.end());
  return run(ops::color_program, image, {{ColorProgram::scale_shift_rgb, step}, std::move(of_codes)});
}

inline Codes const hue_codes{{28.647889756541160438, 255, 255}, {0, 0, 0}};  // hue is radians, codes are 2 degrees
inline Codes const lab_codes{{2.55, 1, 1}, {0, 128, 128}};
inline Codes const luv_codes{{2.55, 255. / 354, 255. / 262}, {0, 134 * 255. / 354, 140 * 255. / 262}};
inline Codes const ycbcr_codes{{255, 255, 255}, {0, 0.5, 0.5}};

}  // namespace detail

inline Tensor color_program(Tensor const& image, ColorProgram const& program) {
  return detail::run(ops::color_program, image, program);
}
// With a step `contrast`; the second result is the mean of each image, around which there was contrast.
inline std::tuple<Tensor, Tensor> color_program_around_mean(Tensor const& image, ColorProgram const& program) {
  return detail::run(ops::color_program_around_mean, image, program);
}

// Each pixel times a matrix, given by rows, plus an offset; the result may be clipped to [0, 1].
inline Tensor mix_channels(Tensor const& image, std::vector<double> matrix,
                           std::vector<double> const& offset = {0, 0, 0}, bool clip = false) {
  matrix.insert(matrix.end(), offset.begin(), offset.end());
  matrix.push_back(clip);
  return detail::converted("mix_channels", image, ColorProgram::affine, std::move(matrix));
}

inline Tensor rgb_to_grayscale(Tensor const& image,
                               std::vector<double> const& rgb_weights = {kLuma[0], kLuma[1], kLuma[2]}) {
  return detail::converted("rgb_to_grayscale", image, ColorProgram::weighted_sum, rgb_weights);
}

// With `opencv`, conversions from RGB take bytes and give OpenCV's 8-bit codes, and conversions to RGB the other way
// round. Without, bytes of RGB are 255ths, and those of other color spaces are an error.
inline Tensor rgb_to_hsv(Tensor const& image, double eps = 1e-8, bool opencv = false) {
  if (detail::are_codes("rgb_to_hsv", detail::colors("rgb_to_hsv", "image", image), opencv))
    return color_program(image, {{ColorProgram::hsv_u8}, {}});
  return detail::converted("rgb_to_hsv", detail::units(image), ColorProgram::rgb_to_hsv, {eps});
}
inline Tensor hsv_to_rgb(Tensor const& image, bool opencv = false) {
  return detail::to_rgb("hsv_to_rgb", image, ColorProgram::hsv_to_rgb, {}, detail::hue_codes, opencv);
}

inline Tensor rgb_to_hls(Tensor const& image, double eps = 1e-8, bool opencv = false) {
  return detail::from_rgb("rgb_to_hls", image, ColorProgram::rgb_to_hls, {eps}, detail::hue_codes, opencv);
}
inline Tensor hls_to_rgb(Tensor const& image, bool opencv = false) {
  return detail::to_rgb("hls_to_rgb", image, ColorProgram::hls_to_rgb, {}, detail::hue_codes, opencv);
}

inline Tensor rgb_to_linear_rgb(Tensor const& image) {
  return detail::converted("rgb_to_linear_rgb", detail::units(image), ColorProgram::rgb_to_linear_rgb);
}
inline Tensor linear_rgb_to_rgb(Tensor const& image) {
  return detail::converted("linear_rgb_to_rgb", detail::units(image), ColorProgram::linear_rgb_to_rgb);
}

inline Tensor rgb_to_lab(Tensor const& image, bool opencv = false) {
  return detail::from_rgb("rgb_to_lab", image, ColorProgram::rgb_to_lab, {}, detail::lab_codes, opencv);
}
inline Tensor lab_to_rgb(Tensor const& image, bool clip = true, bool opencv = false) {
  return detail::to_rgb("lab_to_rgb", image, ColorProgram::lab_to_rgb, {double(clip)}, detail::lab_codes, opencv);
}

inline Tensor rgb_to_luv(Tensor const& image, double eps = 1e-12, bool opencv = false) {
  return detail::from_rgb("rgb_to_luv", image, ColorProgram::rgb_to_luv, {eps}, detail::luv_codes, opencv);
}
inline Tensor luv_to_rgb(Tensor const& image, double eps = 1e-12, bool opencv = false) {
  return detail::to_rgb("luv_to_rgb", image, ColorProgram::luv_to_rgb, {eps}, detail::luv_codes, opencv);
}

inline Tensor rgb_to_ycbcr(Tensor const& image, bool opencv = false) {
  double const r = kLuma[0], g = kLuma[1], b = kLuma[2], blue = 0.564, red = 0.713;
  return detail::from_rgb("rgb_to_ycbcr", image, ColorProgram::affine,
                          {r, g, b, -blue * r, -blue * g, blue * (1 - b), red * (1 - r), -red * g, -red * b,  //
                           0, 0.5, 0.5, 0},
                          detail::ycbcr_codes, opencv);
}
inline Tensor ycbcr_to_rgb(Tensor const& image, bool opencv = false) {
  double const r = kLuma[0], g = kLuma[1], b = kLuma[2], blue = 0.564, red = 0.713;
  return detail::to_rgb("ycbcr_to_rgb", image, ColorProgram::affine,
                        {1, 0, 1 / red, 1, -b / g / blue, -r / g / red, 1, 1 / blue, 0,  //
                         -0.5 / red, (b / blue + r / red) / (2 * g), -0.5 / blue, 1},
                        detail::ycbcr_codes, opencv);
}

// Color filter arrays, by OpenCV's names.
enum class CFA { BG, GB, RG, GR };

// Bayer mosaics (B, 1, H, W) with even H and W to RGB.
inline Tensor raw_to_rgb(Tensor const& image, CFA cfa) {
  return ops::raw_to_rgb(detail::images("raw_to_rgb", "image", image), int64_t(cfa));
}

namespace detail {

inline ops::Two to_yuv(char const* op, Tensor const& image, int64_t rows) {
  double const n = 2 * rows;
  return ops::split_chroma(
      floats(colors(op, "image", image)), rows,
      {kLuma[0], kLuma[1], kLuma[2], -0.147 / n, -0.289 / n, 0.436 / n, 0.615 / n, -0.515 / n, -0.1 / n});
}
inline Tensor from_yuv(char const* op, Tensor const& luma, Tensor const& chroma, int64_t rows) {
  // The inverse of the matrix of to_yuv.
  std::vector<double> const m{kLuma[0], kLuma[1], kLuma[2], -0.147, -0.289, 0.436, 0.615, -0.515, -0.1};
  auto const cofactor = [&](int i, int j) {
    auto const at = [&](int y, int x) { return m[(i + y) % 3 * 3 + (j + x) % 3]; };
    return at(1, 1) * at(2, 2) - at(1, 2) * at(2, 1);
  };
  double const determinant = m[0] * cofactor(0, 0) + m[1] * cofactor(0, 1) + m[2] * cofactor(0, 2);
  std::vector<double> inverse;
  for (int i = 0; i < 9; ++i) inverse.push_back(cofactor(i % 3, i / 3) / determinant);
  return ops::join_chroma(images(op, "imagey", luma), images(op, "imageuv", chroma).to(luma.scalar_type()), rows,
                          inverse);
}

}  // namespace detail

// Y (B, 1, H, W) and UV (B, 2, H / 2, W / 2), the means of 2 x 2 pixels; for 422 (B, 2, H, W / 2).
inline std::tuple<Tensor, Tensor> rgb_to_yuv420(Tensor const& image) {
  return detail::to_yuv("rgb_to_yuv420", image, 2);
}
inline std::tuple<Tensor, Tensor> rgb_to_yuv422(Tensor const& image) {
  return detail::to_yuv("rgb_to_yuv422", image, 1);
}
inline Tensor yuv420_to_rgb(Tensor const& imagey, Tensor const& imageuv) {
  return detail::from_yuv("yuv420_to_rgb", imagey, imageuv, 2);
}
inline Tensor yuv422_to_rgb(Tensor const& imagey, Tensor const& imageuv) {
  return detail::from_yuv("yuv422_to_rgb", imagey, imageuv, 1);
}

}  // namespace kvision
