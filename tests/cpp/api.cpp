// What a user of the C++ API sees besides gradients: results, options and their defaults, and errors. Prints what is
// wrong.
#include <kvision/kvision.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/types.h>

#include <functional>
#include <iostream>

using torch::Tensor;

namespace {

int checks = 0, failures = 0;

void expect(std::string const& name, bool holds) {
  ++checks;
  if (!holds && ++failures) std::cout << name << ": failed\n";
}

void expect_close(std::string const& name, Tensor const& result, Tensor const& expected, double atol = 1e-5) {
  expect(name, result.sizes() == expected.sizes() && torch::allclose(result, expected, 1e-4, atol));
}

template <class Error = std::exception>
void expect_error(std::string const& text, std::function<void()> const& f) {
  ++checks;
  try {
    f();
    std::cout << "no error: " << text << "\n";
    ++failures;
  } catch (Error const& error) {
    std::string const what = error.what();
    if (what.find(text) == std::string::npos && ++failures)
      std::cout << "expected " << text << ", got " << what << "\n";
  }
}

// Functions without a gradient in C++ say so where one is asked for.
void expect_no_gradient(std::string const& name, Tensor const& result) {
  expect_error<c10::NotImplementedError>(name + ": C++ has no gradient", [&] { result.sum().backward(); });
}

// One pass gives what a warp and a color program give one after the other.
void augmentation() {
  using kvision::ColorProgram;
  Tensor const x = torch::rand({2, 3, 9, 7});
  Tensor const M = torch::eye(3).repeat({2, 1, 1}) + 0.02 * torch::rand({2, 3, 3});
  auto const brightness = torch::rand({2, 1, 1}) + 0.5;
  // Brightness by a factor of each image, which is column 0, and saturation.
  ColorProgram program{.steps = {ColorProgram::scale_shift, ColorProgram::saturation},
                       .numbers = {0, 0, 1, 0.7},
                       .columns = {0, -1, -1, -1},
                       .parameters = {brightness}};
  auto const border = kvision::WarpOptions().padding_mode(kvision::PaddingMode::border);
  Tensor const expected = kvision::color_program(kvision::warp_perspective(x, M, {6, 8}, border), program);
  expect_close("warp_and_color", kvision::warp_and_color(x, M, {6, 8}, program, border), expected);
  program.order = torch::tensor({{1, 0}, {0, -1}}, torch::kLong);
  Tensor const ordered = kvision::color_program(kvision::warp_perspective(x, M, {6, 8}), program);
  expect_close("warp_and_color in an order", kvision::warp_and_color(x, M, {6, 8}, program), ordered);
  program.dtype = torch::kHalf;
  program.layout = "NHWC";
  Tensor const bytes = (255 * x).to(torch::kByte), half = kvision::warp_and_color(bytes, M, {6, 8}, program);
  expect("warp_and_color to half",
         half.scalar_type() == torch::kHalf && half.is_contiguous(at::MemoryFormat::ChannelsLast));
  expect_close("warp_and_color of bytes", half.to(torch::kFloat), ordered, 8e-3);
  expect_error("warp_and_color: expected M of shape (B or 1, 3, 3), got",
               [&] { kvision::warp_and_color(x, M.narrow(1, 0, 2), {6, 8}, program); });
  expect_error("warp_and_color: expected M, parameters and order of 2 images or of one, got 3",
               [&] { kvision::warp_and_color(x, M.narrow(0, 0, 1).repeat({3, 1, 1}), {6, 8}, program); });
}

void options() {
  Tensor const x = torch::rand({2, 3, 8, 6});
  Tensor const matrix = torch::tensor({1.f, 0.f, 2.f, 0.f, 1.f, 1.f}).view({1, 2, 3});
  Tensor const shifted = torch::constant_pad_nd(x, {2, -2, 1, -1});
  expect_close("warp_affine", kvision::warp_affine(x, matrix, {8, 6}), shifted);
  auto const fill = kvision::WarpOptions()
                        .mode(kvision::Interpolation::nearest)
                        .padding_mode(kvision::PaddingMode::fill)
                        .fill_value(torch::full({3}, 0.5));
  expect_close("warp_affine with a fill", kvision::warp_affine(x, matrix, {8, 6}, fill),
               torch::constant_pad_nd(x, {2, -2, 1, -1}, 0.5));
  auto const border = kvision::WarpOptions().padding_mode(kvision::PaddingMode::border);
  expect_close("warp_affine with a border", kvision::warp_affine(x, matrix, {8, 6}, border).select(3, 0),
               torch::cat({x.narrow(2, 0, 1), x.narrow(2, 0, 7)}, 2).select(3, 0));
  expect_close("one image and two matrices", kvision::warp_affine(x.narrow(0, 0, 1), matrix.repeat({2, 1, 1}), {8, 6}),
               shifted.narrow(0, 0, 1).expand({2, 3, 8, 6}));
  Tensor const box = torch::tensor({1.f, 2.f, 3.f, 2.f, 3.f, 5.f, 1.f, 5.f}).view({1, 4, 2});
  Tensor const order = torch::tensor({1, 0, 1}, torch::kLong);
  expect_close("boxes of chosen images", kvision::crop_and_resize(x, box.repeat({3, 1, 1}), {4, 3}, {}, order),
               x.index_select(0, order).narrow(2, 2, 4).narrow(3, 1, 3));
  expect("options remember", border.padding_mode() == kvision::PaddingMode::border && border.align_corners());
  expect_close("translate", kvision::translate(x, torch::tensor({{2.f, 1.f}})), shifted);

  Tensor const sigma = torch::tensor({{1.5f, 0.7f}});
  expect_close("gaussian_blur2d of a tensor", kvision::gaussian_blur2d(x, {5, 3}, sigma),
               kvision::gaussian_blur2d(x, {5, 3}, {1.5, 0.7}));
  expect_close("gaussian_blur2d of a variable",
               kvision::gaussian_blur2d(x, {5, 3}, sigma.clone().requires_grad_()).detach(),
               kvision::gaussian_blur2d(x, {5, 3}, {1.5, 0.7}));
  expect_close("one size for both axes", kvision::box_blur(x, 3), kvision::box_blur(x, {3, 3}));
  expect_close("a kernel", kvision::filter2d(x, torch::ones({1, 3, 3}), kvision::FilterOptions().normalized(true)),
               kvision::box_blur(x, 3));
  expect(
      "a valid kernel",
      kvision::filter2d(x, torch::ones({1, 3, 3}), kvision::FilterOptions().padding(kvision::Padding::valid)).sizes() ==
          torch::IntArrayRef({2, 3, 6, 4}));
  expect_close("a number and a tensor", kvision::add_weighted(x, 0.3, x, torch::tensor({0.2f, 0.2f}), 1.0),
               0.5 * x + 1);
  Tensor const bytes = (255 * x).to(torch::kByte), floats = bytes.to(torch::kFloat);
  expect_close("bytes", kvision::gaussian_blur2d(bytes, 3, 1.).to(torch::kFloat),
               kvision::gaussian_blur2d(floats, 3, 1.), 0.51);
  for (Tensor const& integers : {bytes, bytes.to(torch::kInt)}) {
    expect_close("edges of integers", kvision::sobel(integers), kvision::sobel(floats));
    expect_close("gradients of integers", kvision::spatial_gradient(integers), kvision::spatial_gradient(floats));
  }
}

void results() {
  Tensor const colors = torch::rand({2, 3, 4, 6}) * 0.3 + torch::tensor({0.3f, 0.f, 0.6f}).view({3, 1, 1});
  expect_close("rgb_to_hsv", kvision::hsv_to_rgb(kvision::rgb_to_hsv(colors)), colors);
  expect_close("rgb_to_hls", kvision::hls_to_rgb(kvision::rgb_to_hls(colors)), colors);
  expect_close("rgb_to_linear_rgb", kvision::linear_rgb_to_rgb(kvision::rgb_to_linear_rgb(colors)), colors);
  expect_close("rgb_to_lab", kvision::lab_to_rgb(kvision::rgb_to_lab(colors)), colors, 1e-3);
  expect_close("rgb_to_luv", kvision::luv_to_rgb(kvision::rgb_to_luv(colors)), colors, 1e-3);
  expect_close("rgb_to_ycbcr", kvision::ycbcr_to_rgb(kvision::rgb_to_ycbcr(colors)), colors, 1e-3);
  expect_close("rgb_to_grayscale", kvision::rgb_to_grayscale(colors), kvision::rgb_to_ycbcr(colors).slice(1, 0, 1));
  // OpenCV's codes of red, and the way back.
  auto const bytes = [](std::vector<int64_t> const& c) {
    return torch::tensor(c).to(torch::kByte).view({1, 3, 1, 1}).expand({2, 3, 4, 6}).contiguous();
  };
  Tensor const red = bytes({255, 0, 0});
  auto const expect_codes = [&](char const* name, Tensor const& codes, Tensor const& back,
                                std::vector<int64_t> const& expected) {
    expect(name, codes.equal(bytes(expected)) && back.scalar_type() == torch::kByte);
    expect_close(name, back.to(torch::kInt), red.to(torch::kInt), 3);
  };
  Tensor const hsv = kvision::rgb_to_hsv(red, 1e-8, true), hls = kvision::rgb_to_hls(red, 1e-8, true);
  Tensor const lab = kvision::rgb_to_lab(red, true), luv = kvision::rgb_to_luv(red, 1e-12, true);
  Tensor const ycbcr = kvision::rgb_to_ycbcr(red, true);
  expect_codes("HSV of bytes", hsv, kvision::hsv_to_rgb(hsv, true), {0, 255, 255});
  expect_codes("HLS of bytes", hls, kvision::hls_to_rgb(hls, true), {0, 128, 255});
  expect_codes("Lab of bytes", lab, kvision::lab_to_rgb(lab, true, true), {136, 208, 195});
  expect_codes("Luv of bytes", luv, kvision::luv_to_rgb(luv, 1e-12, true), {136, 223, 173});
  expect_codes("YCbCr of bytes", ycbcr, kvision::ycbcr_to_rgb(ycbcr, true), {76, 85, 255});
  expect_close("bytes without codes", kvision::rgb_to_lab(red), kvision::rgb_to_lab(red.to(torch::kFloat) / 255));
  Tensor const flat = colors.narrow(2, 0, 1).narrow(3, 0, 1).repeat({1, 1, 4, 6});
  auto const [luma, chroma] = kvision::rgb_to_yuv420(flat);
  expect_close("rgb_to_yuv420", kvision::yuv420_to_rgb(luma, chroma), flat);

  auto const weak = kvision::CannyOptions().hysteresis(false);
  auto const [magnitude, edges] = kvision::canny(colors, weak);
  expect("canny", ((edges == 0).logical_or(edges == 0.5).logical_or(edges == 1)).all().item<bool>());
  Tensor const joined = kvision::ops::canny_hysteresis(torch::tensor({0.5f, 1.f, 0.f, 0.5f}).view({1, 1, 1, 4}));
  expect("canny_hysteresis", torch::equal(joined, torch::tensor({1.f, 1.f, 0.f, 0.f}).view({1, 1, 1, 4})));
  Tensor const mask = torch::tensor({1.f, 0.f, 1.f}).view({1, 1, 1, 3});
  expect("connected components", torch::equal(kvision::connected_components_union_find(mask),
                                              torch::tensor({1, 0, 3}, torch::kLong).view({1, 1, 1, 3})));
  Tensor const patches = kvision::extract_tensor_patches(colors, {2, 3}, {1, 1});
  expect_close("patches and back", kvision::combine_tensor_patches(patches, {4, 6}, {2, 3}, {1, 1}), colors);
  expect_close("opening", kvision::opening(colors, torch::ones({1, 1})), colors);
  expect_close("psnr", kvision::psnr(colors, colors + 0.1, 1), torch::tensor(20.f), 1e-3);
  Tensor const labels = torch::tensor({{0, 1, 1}}, torch::kLong), truth = torch::tensor({{0, 0, 1}}, torch::kLong);
  expect_close("confusion_matrix", kvision::confusion_matrix(labels, truth, 2).to(torch::kFloat),
               torch::tensor({1.f, 1.f, 0.f, 1.f}).view({1, 2, 2}));
  expect_close("mean_iou", kvision::mean_iou(labels, truth, 2), torch::tensor({{0.5f, 0.5f}}));
  Tensor const boxes = torch::tensor({{0.f, 0.f, 2.f, 2.f}});
  expect_close("mean_iou_bbox", kvision::mean_iou_bbox(boxes, boxes), torch::ones({1, 1}));
  expect("nms2d", torch::equal(kvision::nms2d(colors, 3, true), kvision::nms2d(colors, 3) > 0));
  expect("vflip", torch::equal(kvision::vflip(kvision::hflip(colors)), kvision::rot180(colors)));
  expect("resize", kvision::resize(colors, {2, 3}, kvision::ResizeOptions().antialias(true)).size(2) == 2);
  expect_close("pyramid", kvision::pyrup(kvision::pyrdown(colors)) + kvision::build_laplacian_pyramid(colors, 1)[0],
               colors);

  Tensor const from = torch::rand({2, 9, 2}), shift = torch::tensor({0.5f, 0.f});
  Tensor const K = torch::tensor({2.f, 0.f, 0.f, 0.f, 2.f, 0.f, 0.f, 0.f, 1.f}).view({1, 3, 3});
  Tensor const new_K = torch::tensor({4.f, 0.f, 1.f, 0.f, 4.f, 1.f, 0.f, 0.f, 1.f}).view({1, 3, 3});
  expect_close("undistort_points", kvision::undistort_points(from, K, torch::zeros({1, 4}), new_K), 2 * from + 1);
  Tensor const dist = 0.03 * torch::rand({2, 14}), variable = from.clone().requires_grad_();
  expect_close("undistort_points of variables", kvision::undistort_points(variable, K, dist, new_K).detach(),
               kvision::undistort_points(from, K, dist, new_K));
  Tensor const distorted = kvision::distort_points(from, K, dist);
  expect_close("distort_points of variables", kvision::distort_points(variable, K, dist).detach(), distorted);
  expect_close("distort_points and back", kvision::undistort_points(distorted, K, dist, {}, 60), from, 1e-3);
  Tensor const eye = torch::eye(3).expand({2, 3, 3}), still = torch::eye(3, 4).expand({2, 3, 4});
  Tensor const moved = torch::cat({still.narrow(2, 0, 3), still.narrow(2, 0, 1)}, 2);
  Tensor const space = torch::cat({2 * from, torch::full({2, 9, 1}, 2.f)}, 2);
  expect_close("triangulate_points", kvision::triangulate_points(still, moved, from, from + shift), space, 1e-3);
  Tensor const sideways = torch::tensor({{0.f, 0.f, 0.f}, {0.f, 0.f, -1.f}, {0.f, 1.f, 0.f}}).expand({2, 3, 3});
  auto const motion = kvision::motion_from_essential_choose_solution(sideways, eye, eye, from, from + shift);
  expect_close("motion_from_essential_choose_solution", std::get<2>(motion), space, 1e-3);
  Tensor const levels = torch::tensor({1.f, 2.f, 3.f}).expand({2, 3});
  expect_close("eigenvectors", std::get<0>(kvision::ops::eigenvectors(torch::diag_embed(levels.flip(1)))), levels);
  Tensor const points = from.transpose(1, 2).contiguous(), one = torch::eye(3).expand({2, 1, 3, 3});
  int64_t const homography = int64_t(kvision::ops::Model::homography);
  Tensor const none = torch::zeros({2, 1, 2}), small = torch::full({2}, 0.1f);
  auto const [best, scores, required] = kvision::ops::keep_best_models(
      one, points, points, 0 * one, none, small, torch::full({2}, 9.f), 1, true, homography, 0.99, 99);
  expect_close("keep_best_models", best, one);
  expect_close("keep_best_models, scores", scores, torch::full({2, 1, 2}, 9.f));
  expect_close("keep_best_models, samples", required.to(torch::kFloat), torch::ones({2}));
  Tensor const pixels = points.to(torch::kDouble);
  auto const [fitted, sums] = kvision::ops::two_view_fits(one.to(torch::kDouble), pixels, pixels, {},
                                                          torch::full({2}, 0.1, torch::kDouble), 1, homography, false);
  expect_close("two_view_fits", fitted / fitted.slice(2, 2).slice(3, 2), one.to(torch::kDouble));
}

// Matches of descriptors, compared with distances of all pairs.
void matches() {
  Tensor const first = torch::rand({40, 6}), second = torch::rand({30, 6}), distances = torch::cdist(first, second);
  auto const [rows, indices] = torch::topk(distances, 2, 1, false);
  auto const [columns, indices_back] = torch::topk(distances, 2, 0, false);
  Tensor const nearest = indices.select(1, 0), nearest_back = indices_back[0].index_select(0, nearest);
  Tensor const ratios =
      torch::maximum(rows.select(1, 0) / rows.select(1, 1), (columns[0] / columns[1]).index_select(0, nearest));
  Tensor const kept = ((nearest_back == torch::arange(40)) & (ratios <= 0.9)).nonzero().select(1, 0);
  auto const [scores, pairs] = kvision::match_smnn(first, second, 0.9);
  expect("matches exist", kept.numel() > 0 && kept.numel() < 30);
  expect_close("match_smnn", scores, ratios.index_select(0, kept).unsqueeze(1));
  expect("indices of match_smnn", torch::equal(pairs, torch::stack({kept, nearest.index_select(0, kept)}, 1)));
}

void gradients() {
  // Levels have no gradient, and a plane of one level comes back with its own.
  Tensor const planes = torch::cat({torch::rand({2, 2, 7, 6}), torch::full({2, 1, 7, 6}, 0.3f)}, 1).requires_grad_();
  auto const to_planes = [&](Tensor const& y) { return torch::autograd::grad({y.sum()}, {planes})[0].mean({0, 2, 3}); };
  expect("equalize", torch::equal(to_planes(kvision::equalize(planes, true)), torch::tensor({0.f, 0.f, 1.f})));
  expect("equalize_clahe", !to_planes(kvision::equalize_clahe(planes)).any().item<bool>());
  expect("constants", !kvision::connected_components_union_find(planes).requires_grad());
  auto const [losses, order] = kvision::ops::lovasz(planes, torch::zeros({2, 7, 6}, torch::kLong), false);
  expect("what is saved for the gradient is constant", losses.requires_grad() && !order.requires_grad());
  {
    torch::NoGradGuard no_grad;
    expect("no graph without gradients", !kvision::sobel(planes).requires_grad());
  }

  expect_no_gradient("real_roots", kvision::ops::real_roots(torch::tensor({{1.f, -3.f, 2.f}}).requires_grad_()));
  // Of an overlap 1 of areas 4 and 4, which grows by 1 with a side, as the area does by 2.
  Tensor const first = torch::tensor({{0.f, 0.f, 2.f, 2.f}}).requires_grad_(), second = (first + 1).detach();
  Tensor const to_first = torch::autograd::grad({kvision::mean_iou_bbox(first, second).sum()}, {first})[0];
  expect_close("the gradient of box_iou", to_first, torch::tensor({{2.f, 2.f, 6.f, 6.f}}) / 49);
  second.requires_grad_();
  Tensor const to_second = torch::autograd::grad({kvision::mean_iou_bbox(first, second).sum()}, {second})[0];
  expect_close("the gradient of box_iou to the other boxes", to_second, -to_first.flip(1));
  Tensor const points = torch::rand({2, 3, 2}).requires_grad_();
  expect_no_gradient("minimal_solver",
                     kvision::ops::minimal_solver(points, points, {}, int64_t(kvision::ops::Model::affine)));
  Tensor const heights = torch::rand({1, 3, 3}).requires_grad_(), element = torch::ones({3, 3});
  expect_error<c10::NotImplementedError>("dilation: C++ has no gradient to heights", [&] {
    kvision::dilation(planes, element, kvision::MorphologyOptions().structuring_element(heights[0])).sum().backward();
  });
  expect_error<c10::NotImplementedError>("sobel: C++ has no second derivative of it", [&] {
    Tensor const y = kvision::sobel(planes);
    Tensor const first = torch::autograd::grad({(y * y).sum()}, {planes}, {}, std::nullopt, true)[0];
    torch::autograd::grad({first.sum()}, {planes});
  });
  expect("any operator by its name",
         torch::equal(kvision::ops::call("sobel", {planes.detach(), true, 1e-6})[0], kvision::sobel(planes.detach())));
}

void errors() {
  Tensor const x = torch::rand({1, 3, 8, 8}), matrix = torch::eye(3).unsqueeze(0);
  using Value = c10::ValueError;
  expect_error<Value>("sobel: expected input of shape (B, C, H, W), got [3, 8, 8]", [&] { kvision::sobel(x[0]); });
  expect_error<Value>("warp_affine: expected M of shape (B or 1, 2, 3), got [1, 3, 3]",
                      [&] { kvision::warp_affine(x, matrix, {8, 8}); });
  expect_error<Value>("warp_perspective: expected a fill_value with padding_mode fill only", [&] {
    kvision::warp_perspective(x, matrix, {8, 8}, kvision::WarpOptions().fill_value(torch::ones({3})));
  });
  expect_error<Value>("rgb_to_hsv: expected image of shape (B, 3, H, W), got [1, 2, 8, 8]",
                      [&] { kvision::rgb_to_hsv(x.narrow(1, 0, 2)); });
  expect_error<c10::TypeError>("rgb_to_lab: expected image to be uint8 with opencv, got Float",
                               [&] { kvision::rgb_to_lab(x, true); });
  expect_error<Value>("ssim: expected img2 of shape [1, 3, 8, 8], got [1, 3, 4, 8]",
                      [&] { kvision::ssim(x, x.narrow(2, 0, 4), 5); });
  expect_error<Value>("dice_loss: expected target of shape (B, H, W) for pred of [1, 3, 8, 8], got [8, 8]",
                      [&] { kvision::dice_loss(x, torch::zeros({8, 8}, torch::kLong)); });
  expect_error<c10::TypeError>("focal_loss: expected target of int64, got Float",
                               [&] { kvision::focal_loss(x, torch::zeros({1, 8, 8})); });
  expect_error<Value>("find_homography_dlt: expected points1 of shape (B, N, 2), got [4, 2]",
                      [&] { kvision::find_homography_dlt(torch::rand({4, 2}), torch::rand({4, 2})); });
  expect_error("box_blur", [&] { kvision::box_blur(x, 0); });
  expect_error("Expected a value of type 'bool' for argument 'normalized'",
               [&] { kvision::ops::call("sobel", {x, "yes", 1e-6}); });
}

}  // namespace

int main() {
  torch::manual_seed(0);
  options();
  augmentation();
  results();
  matches();
  gradients();
  errors();
  std::cout << checks << " checks, " << failures << " failures\n";
  return failures > 0;
}
