// Colour programs, chains of per-pixel steps in one pass over the image, and the conversions of python/kvision/color,
// which are programs of one step. Images are (B, 3, H, W), floating point. A second derivative is an error.
#pragma once

#include <algorithm>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "kvision/operator.h"

namespace kvision {

// The steps and all their parameters as `numbers`. Those that are tensors stand in p0, p1 and so on, (B or 1, C or 1,
// P) of floating-point numbers; `columns` has their places, counted along the last axes of all tensors, and -1 for
// numbers. `order` (B or 1, S) of int64 has the step of each position, or -1 for none. The result has the dtype and
// the layout, "NCHW" or "NHWC", that are asked for; bytes are 255ths.
struct ColorProgram {
  // With their parameters, as csrc/color/step_list.h explains them.
  enum Step : int64_t {
    affine,
    rgb_to_hsv,
    hsv_to_rgb,
    rgb_to_hls,
    hls_to_rgb,
    rgb_to_linear_rgb,
    linear_rgb_to_rgb,
    rgb_to_lab,
    lab_to_rgb,
    rgb_to_luv,
    luv_to_rgb,
    luma_u8_fixed_point,
    hsv_u8,
    weighted_sum,
    luma_u8,
    scale_shift_rgb,
    standardize_rgb,
    saturation,
    saturation_raw,
    saturation_gray,
    hue,
    hue_raw,
    contrast,
    scale_shift,
    standardize,
    gamma,
    log,
    sigmoid,
    solarize,
    posterize,
    threshold,
  };
  std::vector<int64_t> steps;
  std::vector<double> numbers;
  std::vector<int64_t> columns = {};
  std::optional<Tensor> p0 = {};
  std::optional<Tensor> p1 = {};
  std::optional<Tensor> p2 = {};
  std::optional<Tensor> p3 = {};
  std::optional<Tensor> p4 = {};
  std::optional<Tensor> p5 = {};
  std::optional<Tensor> order = {};
  std::optional<at::ScalarType> dtype = {};
  std::string layout = "same";

  // The plan of the operators: dtype and layout, by number or -1 for those of the input, then how many steps, the steps
  // and the columns.
  std::vector<int64_t> plan() const {
    constexpr at::ScalarType types[] = {at::kByte, at::kHalf, at::kBFloat16, at::kFloat, at::kDouble};
    auto const* const found = std::find(std::begin(types), std::end(types), dtype.value_or(at::kByte));
    std::vector<int64_t> all{dtype ? found - types : -1, layout == "same" ? -1 : layout == "NHWC",
                             int64_t(steps.size())};
    all.insert(all.end(), steps.begin(), steps.end());
    all.insert(all.end(), columns.begin(), columns.end());
    return all;
  }

  // An undefined Tensor for what there is not.
  std::vector<Tensor> parameters() const {
    std::vector<Tensor> all;
    for (auto const* p : {&p0, &p1, &p2, &p3, &p4, &p5}) all.push_back(p->value_or(Tensor()));
    return all;
  }
};

namespace detail {

inline variable_list with_parameters(variable_list tensors, ColorProgram const& p) {
  for (Tensor const& parameter : p.parameters()) tensors.push_back(parameter);
  return tensors;
}

}  // namespace detail

// The gradients of the image and of all columns of the parameters, the latter for each sample; without elements where
// not wanted.
inline std::tuple<Tensor, Tensor> color_program_backward(Tensor const& grad, Tensor const& input, ColorProgram const& p,
                                                         std::optional<Tensor> const& means, bool of_image,
                                                         bool of_parameters) {
  using namespace detail;
  auto const compute = [&] {
    auto const [of_x, of_rows] = call<"color_program_backward", std::tuple<Tensor, Tensor>>(
        grad, input, p.p0, p.p1, p.p2, p.p3, p.p4, p.p5, p.order, means, p.plan(), p.numbers, of_image, of_parameters);
    return variable_list{of_x, of_rows};
  };
  auto const found =
      differentiable(with_parameters({grad, input}, p), compute, {}, no_second_derivative("color_program"));
  return {found[0], found[1]};
}

namespace detail {

inline variable_list color_gradients(Backward const& b, ColorProgram const& p, std::optional<Tensor> const& mean) {
  variable_list const parameters = p.parameters();
  bool of_parameters = false;
  for (size_t i = 0; i < parameters.size(); ++i) of_parameters = of_parameters || b.wanted(1 + i);
  auto const [of_x, of_rows] = color_program_backward(b.grads[0], b.saved[0], p, mean, b.wanted(0), of_parameters);
  variable_list found{b.wanted(0) ? of_x : Tensor()};
  int64_t first = 0;
  for (size_t i = 0; i < parameters.size(); ++i) {
    Tensor const& own = parameters[i];
    int64_t const columns = own.defined() ? own.size(2) : 0;
    bool const wanted = b.wanted(1 + i);
    found.push_back(wanted ? of_rows.narrow(2, first, columns).sum_to_size(own.sizes()).to(own.scalar_type())
                           : Tensor());
    first += columns;
  }
  return found;
}

}  // namespace detail

inline Tensor color_program(Tensor const& input, ColorProgram const& p) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"color_program">(input, p.p0, p.p1, p.p2, p.p3, p.p4, p.p5, p.order, p.plan(), p.numbers)};
  };
  auto const gradient = [=](Backward const& b) { return color_gradients(b, p, {}); };
  return differentiable(with_parameters({input}, p), compute, {input}, gradient)[0];
}

// With a step `contrast`, and the mean of each sample around which there was contrast as the second result.
inline std::tuple<Tensor, Tensor> color_program_around_mean(Tensor const& input, ColorProgram const& p) {
  using namespace detail;
  Tensor mean;
  auto const compute = [&] {
    auto const [y, found] = call<"color_program_around_mean", std::tuple<Tensor, Tensor>>(
        input, p.p0, p.p1, p.p2, p.p3, p.p4, p.p5, p.order, p.plan(), p.numbers);
    mean = found;
    return variable_list{y};
  };
  // The mean is there only when the gradient is: it is kept by reference until then.
  auto const kept = std::make_shared<Tensor>();
  auto const gradient = [=](Backward const& b) { return color_gradients(b, p, *kept); };
  Tensor const y = differentiable(with_parameters({input}, p), compute, {input}, gradient)[0];
  *kept = mean;
  return {y, mean};
}

// --- conversions

namespace detail {

inline Tensor converted(Tensor const& image, ColorProgram::Step step, std::vector<double> numbers = {}) {
  return color_program(image, {{step}, std::move(numbers)});
}

}  // namespace detail

// The channels mixed by a matrix, given by rows; `offset` is added, and the result may be clipped to [0, 1].
inline Tensor mix_channels(Tensor const& image, std::vector<double> matrix,
                           std::vector<double> const& offset = {0, 0, 0}, bool clip = false) {
  matrix.insert(matrix.end(), offset.begin(), offset.end());
  matrix.push_back(clip);
  return detail::converted(image, ColorProgram::affine, std::move(matrix));
}

inline Tensor rgb_to_grayscale(Tensor const& image, std::vector<double> const& weights = {0.299, 0.587, 0.114}) {
  return detail::converted(image, ColorProgram::weighted_sum, weights);
}

inline Tensor rgb_to_hsv(Tensor const& image, double eps = 1e-8) {
  return detail::converted(image, ColorProgram::rgb_to_hsv, {eps});
}
inline Tensor hsv_to_rgb(Tensor const& image) { return detail::converted(image, ColorProgram::hsv_to_rgb); }

inline Tensor rgb_to_hls(Tensor const& image, double eps = 1e-8) {
  return detail::converted(image, ColorProgram::rgb_to_hls, {eps});
}
inline Tensor hls_to_rgb(Tensor const& image) { return detail::converted(image, ColorProgram::hls_to_rgb); }

inline Tensor rgb_to_linear_rgb(Tensor const& image) {
  return detail::converted(image, ColorProgram::rgb_to_linear_rgb);
}
inline Tensor linear_rgb_to_rgb(Tensor const& image) {
  return detail::converted(image, ColorProgram::linear_rgb_to_rgb);
}

inline Tensor rgb_to_lab(Tensor const& image) { return detail::converted(image, ColorProgram::rgb_to_lab); }
inline Tensor lab_to_rgb(Tensor const& image, bool clip = true) {
  return detail::converted(image, ColorProgram::lab_to_rgb, {double(clip)});
}

inline Tensor rgb_to_luv(Tensor const& image, double eps = 1e-12) {
  return detail::converted(image, ColorProgram::rgb_to_luv, {eps});
}
inline Tensor luv_to_rgb(Tensor const& image, double eps = 1e-12) {
  return detail::converted(image, ColorProgram::luv_to_rgb, {eps});
}

inline Tensor rgb_to_ycbcr(Tensor const& image) {
  double const r = 0.299, g = 0.587, b = 0.114, blue = 0.564, red = 0.713;
  return mix_channels(image, {r, g, b, -blue * r, -blue * g, blue * (1 - b), red * (1 - r), -red * g, -red * b},
                      {0, 0.5, 0.5});
}
inline Tensor ycbcr_to_rgb(Tensor const& image) {
  double const r = 0.299, g = 0.587, b = 0.114, blue = 0.564, red = 0.713;
  return mix_channels(image, {1, 0, 1 / red, 1, -b / g / blue, -r / g / red, 1, 1 / blue, 0},
                      {-0.5 / red, (b / blue + r / red) / (2 * g), -0.5 / blue}, true);
}

// --- mosaics

inline Tensor raw_to_rgb(Tensor const& input, int64_t cfa);

// Linear, as is its transpose.
inline Tensor raw_to_rgb_backward(Tensor const& grad, int64_t cfa) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"raw_to_rgb_backward">(grad, cfa)}; };
  auto const gradient = [=](Backward const& b) { return variable_list{raw_to_rgb(b.grads[0], cfa)}; };
  return differentiable({grad}, compute, {}, gradient)[0];
}
// RGB images of Bayer mosaics (B, 1, H, W) with even H and W, whose color filter array is 0 (BG), 1 (GB), 2 (RG) or 3
// (GR), OpenCV's names.
inline Tensor raw_to_rgb(Tensor const& input, int64_t cfa) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"raw_to_rgb">(input, cfa)}; };
  auto const gradient = [=](Backward const& b) { return variable_list{raw_to_rgb_backward(b.grads[0], cfa)}; };
  return differentiable({input}, compute, {}, gradient)[0];
}

// --- chroma that cells share

namespace detail {
inline std::vector<double> transposed(std::vector<double> const& m) {
  return {m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]};
}
}  // namespace detail

inline std::tuple<Tensor, Tensor> split_chroma(Tensor const& input, int64_t rows, std::vector<double> const& matrix);

// Colours of luma (B, 1, H, W) and of the chroma (B, 2, H / rows, W / 2) that `rows` of two pixels share, by a 3 x 3
// matrix in rows. Its gradient is split_chroma with the transposed matrix, and the other way round.
inline Tensor join_chroma(Tensor const& luma, Tensor const& chroma, int64_t rows, std::vector<double> const& matrix) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"join_chroma">(luma, chroma, rows, matrix)}; };
  auto const gradient = [=](Backward const& b) {
    auto const [of_luma, of_chroma] = split_chroma(b.grads[0], rows, transposed(matrix));
    return variable_list{of_luma, of_chroma};
  };
  return differentiable({luma, chroma}, compute, {}, gradient)[0];
}
// Luma of RGB images by the first row of a matrix, and chroma of the sums of `rows` of two pixels by the others.
inline std::tuple<Tensor, Tensor> split_chroma(Tensor const& input, int64_t rows, std::vector<double> const& matrix) {
  using namespace detail;
  auto const compute = [&] {
    auto const [luma, chroma] = call<"split_chroma", std::tuple<Tensor, Tensor>>(input, rows, matrix);
    return variable_list{luma, chroma};
  };
  auto const gradient = [=](Backward const& b) {
    return variable_list{join_chroma(b.grads[0], b.grads[1], rows, transposed(matrix))};
  };
  auto const found = differentiable({input}, compute, {}, gradient);
  return {found[0], found[1]};
}

// Images in the colours of a table (1, 3, n), of which `white` (B, C) shows the last one. The table has no gradient
// here.
inline Tensor apply_colormap(Tensor const& input, Tensor const& white, Tensor const& colors) {
  return detail::call<"apply_colormap">(input.detach(), white.detach(), colors.detach());
}

}  // namespace kvision
