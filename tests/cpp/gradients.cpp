// Every differentiable function of the C++ API on small tensors: its gradients against central differences, and, where
// it has them, its second derivatives. Prints the names of those that fail.
#include <kvision/kvision.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/types.h>

#include <cmath>
#include <functional>
#include <iostream>

using torch::Tensor;
using torch::autograd::variable_list;
using Function = std::function<Tensor(variable_list const&)>;

namespace ops = kvision::ops;
using kvision::BorderType, kvision::Distance, kvision::Interpolation, kvision::Reduction;

namespace {

int checks = 0, failures = 0;

// The gradients of sum(w f(x)^2) for fixed random weights w.
variable_list gradients(Function const& f, variable_list const& inputs, bool create_graph = false) {
  torch::manual_seed(1);
  Tensor const y = f(inputs);
  Tensor const loss = (torch::rand_like(y) * y * y).sum();
  return torch::autograd::grad({loss}, inputs, {}, std::nullopt, create_graph);
}

// The derivative of scalar function `f` along random directions, against the gradients.
void compare(std::string const& name, std::function<double(variable_list const&)> const& f, variable_list const& inputs,
             variable_list const& gradients) {
  for (size_t i = 0; i < inputs.size(); ++i, ++checks) {
    torch::NoGradGuard no_grad;
    Tensor const step = 1e-5 * torch::randn_like(inputs[i]);
    variable_list before = inputs, after = inputs;
    before[i] = (inputs[i] - step).requires_grad_();
    after[i] = (inputs[i] + step).requires_grad_();
    double const numeric = (f(after) - f(before)) / 2, analytic = (gradients[i] * step).sum().item<double>();
    if (!(std::abs(numeric - analytic) <= 1e-5 * std::abs(numeric) + 1e-10) && ++failures)
      std::cout << name << ", argument " << i << ": " << analytic << ", expected " << numeric << "\n";
  }
}

void check(std::string const& name, Function const& f, variable_list inputs, bool twice = true) {
  for (Tensor& x : inputs) x = x.to(torch::kDouble).requires_grad_();
  auto const loss = [&](variable_list const& x) {
    torch::manual_seed(1);
    Tensor const y = f(x);
    return (torch::rand_like(y) * y * y).sum().item<double>();
  };
  variable_list const first = gradients(f, inputs, true);
  compare(name, loss, inputs, first);

  // sum(grad^2) differentiates the gradient.
  auto const square = [](variable_list const& grads) {
    Tensor sum = torch::zeros({}, torch::kDouble);
    for (Tensor const& g : grads) sum = sum + (g * g).sum();
    return sum;
  };
  if (!twice) {
    try {
      torch::autograd::grad({square(first)}, inputs);
      std::cout << name << ": a second derivative without an error\n";
      ++failures;
    } catch (c10::NotImplementedError const&) {
    }
    return;
  }
  variable_list const second = torch::autograd::grad({square(first)}, inputs);
  auto const squared = [&](variable_list const& x) {
    torch::AutoGradMode enable(true);
    return square(gradients(f, x)).item<double>();
  };
  compare(name + " twice", squared, inputs, second);
}

}  // namespace

int main() {
  torch::manual_seed(0);
  Tensor const x = torch::rand({2, 2, 7, 6}), other = torch::rand_like(x), volume = torch::rand({1, 2, 5, 4, 6});
  Tensor const row = torch::rand({1, 3}), column = torch::rand({2, 5}), sigma = torch::rand({2, 2}) + 0.5;
  static constexpr auto none = std::nullopt;
  auto const to_double = [](Tensor const& t) { return t.to(torch::kDouble); };

  // --- filters

  check("sobel", [](auto const& t) { return kvision::sobel(t[0]); }, {x}, false);
  for (auto const mode : {kvision::DerivativeMode::sobel, kvision::DerivativeMode::diff})
    for (int order : {1, 2})
      check("spatial_gradient", [=](auto const& t) { return kvision::spatial_gradient(t[0], mode, order); }, {x});
  for (int order : {1, 2})
    check("spatial_gradient3d", [=](auto const& t) { return kvision::spatial_gradient3d(t[0], order); }, {volume});
  for (auto const border : {BorderType::constant, BorderType::reflect, BorderType::replicate, BorderType::circular}) {
    check("box_blur", [=](auto const& t) { return kvision::box_blur(t[0], {5, 3}, border); }, {x});
    check("laplacian", [=](auto const& t) { return kvision::laplacian(t[0], {3, 5}, border); }, {x});
    check("median_blur", [=](auto const& t) { return kvision::median_blur(t[0], 3, border); }, {x}, false);
    auto const bilateral = [=](auto const& t) {
      return kvision::bilateral_blur(t[0], {3, 5}, 0.4, {1.5, 0.9}, border);
    };
    check("bilateral_blur", bilateral, {x}, false);
    auto const joint = [=](auto const& t) {
      return kvision::joint_bilateral_blur(t[0], t[1], {3, 5}, t[2], t[3], border, Distance::l2);
    };
    check("joint_bilateral_blur", joint, {x, torch::rand({1, 3, 7, 6}).expand({2, 3, 7, 6}), sigma.select(1, 0), sigma},
          false);
    auto const options = kvision::FilterOptions().border_type(border);
    auto const filter = [=](auto const& t) { return kvision::filter2d(t[0], t[1], options); };
    check("filter2d", filter, {x, torch::rand({1, 3, 4}) - 0.3});
    check("filter2d of a kernel each", filter, {x, torch::rand({2, 5, 3}) - 0.3});
    auto const filter_volume = [=](auto const& t) { return kvision::filter3d(t[0], t[1], options); };
    check("filter3d", filter_volume, {volume, torch::rand({1, 3, 2, 3}) - 0.3});
    auto const separable = [=](auto const& t) { return kvision::filter2d_separable(t[0], t[1], t[2], options); };
    check("filter2d_separable", separable, {x, row, column}, false);
    auto const constant = [=](auto const& t) { return kvision::filter2d_separable(t[0], row, column, options); };
    check("filter2d_separable of constant kernels", constant, {x});
    auto const blur = [=](auto const& t) { return kvision::gaussian_blur2d(t[0], {5, 3}, {1.5, 0.7}, border); };
    check("gaussian_blur2d", blur, {x});
    auto const blur_of_variable = [=](auto const& t) { return kvision::gaussian_blur2d(t[0], {5, 3}, t[1], border); };
    check("gaussian_blur2d of sigma", blur_of_variable, {x, sigma}, false);
    auto const sharpen = [=](auto const& t) { return kvision::unsharp_mask(t[0], {5, 3}, {1.5, 0.7}, border); };
    check("unsharp_mask", sharpen, {x});
    auto const sharpen_of_variable = [=](auto const& t) { return kvision::unsharp_mask(t[0], {5, 3}, t[1], border); };
    check("unsharp_mask of sigma", sharpen_of_variable, {x, sigma}, false);
  }
  auto const normalized = kvision::FilterOptions().normalized(true).padding(kvision::Padding::valid);
  check("filter2d, normalized", [=](auto const& t) { return kvision::filter2d(t[0], t[1], normalized); },
        {x, torch::rand({1, 3, 4}) + 0.1});
  auto const canny = [](auto const& t) {
    return std::get<0>(kvision::canny(t[0], kvision::CannyOptions().low_threshold(0.01).high_threshold(0.02)));
  };
  check("canny", canny, {torch::rand({1, 3, 9, 8})}, false);

  // --- color and enhance

  Tensor const colors = torch::rand({2, 3, 4, 6}) * 0.3 + torch::tensor({0.3f, 0.f, 0.6f}).view({3, 1, 1});
  using Conversion = Tensor (*)(Tensor const&);
#define CONVERSION(name) [](Tensor const& x) { return kvision::name(x); }
  Conversion const there_and_back[][2] = {
      {CONVERSION(rgb_to_hsv), CONVERSION(hsv_to_rgb)},
      {CONVERSION(rgb_to_hls), CONVERSION(hls_to_rgb)},
      {CONVERSION(rgb_to_linear_rgb), CONVERSION(linear_rgb_to_rgb)},
      {CONVERSION(rgb_to_lab), CONVERSION(lab_to_rgb)},
      {CONVERSION(rgb_to_luv), CONVERSION(luv_to_rgb)},
      {CONVERSION(rgb_to_ycbcr), CONVERSION(ycbcr_to_rgb)},
  };
#undef CONVERSION
  for (auto const [there, back] : there_and_back) {
    check("a conversion", [=](auto const& t) { return there(t[0]); }, {colors}, false);
    check("its inverse", [=](auto const& t) { return back(t[0]); }, {there(colors)}, false);
  }
  check("rgb_to_grayscale", [](auto const& t) { return kvision::rgb_to_grayscale(t[0]); }, {colors}, false);
  check("rgb_to_yuv420",
        [](auto const& t) {
          auto const [luma, chroma] = kvision::rgb_to_yuv420(t[0]);
          return kvision::yuv420_to_rgb(luma.square(), chroma.square());
        },
        {colors});
  check("raw_to_rgb", [](auto const& t) { return kvision::raw_to_rgb(t[0], kvision::CFA::GB); },
        {torch::rand({2, 1, 4, 6})});
  using Program = kvision::ColorProgram;
  auto const contrast = [](auto const& t) {
    Program const program{{Program::contrast, Program::gamma}, {0, 0, 0, 0.9}, {0, -1, 1, -1}, {t[1], t[2]}};
    return std::get<0>(kvision::color_program_around_mean(t[0], program));
  };
  check("color_program_around_mean", contrast, {colors, 0.7 + 0.5 * torch::rand({2, 1, 1}), torch::ones({1, 1, 1})},
        false);
  check("add_weighted", [](auto const& t) { return kvision::add_weighted(t[0], t[2], t[1], 0.3, t[3]); },
        {x, other, torch::rand({2}), torch::rand({1, 2})});
  check("sharpness", [](auto const& t) { return kvision::sharpness(t[0], t[1]); }, {x, torch::rand({2})}, false);
  check(
      "jpeg_codec_differentiable", [](auto const& t) { return kvision::jpeg_codec_differentiable(t[0], t[1], t[2]); },
      {torch::rand({2, 3, 5, 6}), 20 + 50 * torch::rand({2}), 20 + 50 * torch::rand({1, 8, 8})}, false);
  check("normalize_min_max", [](auto const& t) { return kvision::normalize_min_max(t[0], -1, 2); }, {x}, false);
  check("histogram", [&](auto const& t) { return kvision::histogram(t[0], row[0], 0.2); }, {column}, false);
  check("image_histogram2d", [](auto const& t) { return kvision::image_histogram2d(t[0], 0, 1, 4); }, {x}, false);

  // --- augmentation

  Tensor const keys = torch::tensor({5}, torch::kLong), half = torch::tensor({1.f, 0.f});
  kvision::ops::Ints const draw = {0, 0, 1, 0};
  auto const noise = [&](auto const& t) { return ops::gaussian_noise(t[0], t[1], keys, none, half, draw); };
  check("gaussian_noise", noise, {x, torch::rand({2, 2})});
  check(
      "warp_and_color",
      [](auto const& t) {
        using kvision::ColorProgram;
        ColorProgram const program{
            .steps = {ColorProgram::scale_shift}, .numbers = {0, 0.1, 0}, .columns = {0, -1, -1}, .parameters = {t[2]}};
        return kvision::warp_and_color(t[0], t[1], {5, 4}, program);
      },
      {torch::rand({2, 3, 7, 6}), torch::eye(3).repeat({2, 1, 1}) + 0.02 * torch::rand({2, 3, 3}),
       torch::rand({2, 1, 1}) + 0.5},
      false);
  auto const uniform = [&](auto const& t) { return ops::uniform_noise(t[0], t[1], keys, none, half, draw); };
  check("uniform_noise", uniform, {x, torch::rand({2, 2})});
  Tensor const shares = torch::full({1, 2}, 0.5, torch::kDouble), boxes = torch::tensor({{{1.f, 2.f, 3.f, 2.f}}});
  check("salt_and_pepper", [&](auto const& t) { return ops::salt_and_pepper(t[0], shares, keys, none, none, draw); },
        {x});
  check(
      "erase_rectangles", [&](auto const& t) { return ops::erase_rectangles(t[0], boxes, t[1]); },
      {x, torch::rand({2, 1})}, false);
  Tensor const grids = torch::tensor({{0.5f, 0.3f, 0.2f, 0.1f, 2.f}});
  check(
      "erase_grid", [&](auto const& t) { return ops::erase_grid(t[0], grids, t[1]); }, {x, torch::rand({2, 1})}, false);
  check(
      "transform_matrix",
      [](auto const& t) {
        return ops::transform_matrix(t[0], {0, 0, 1, -1, 2, -1, -1, -1, -1, -1}, {0, 0, 3, 1, 1, 0.1, 0, 2, 1});
      },
      {row}, false);

  // --- losses, metrics, morphology, contrib

  Tensor const labels = torch::randint(0, 2, {2, 7, 6}), hinge = labels.unsqueeze(1);
  Tensor const weight = torch::rand({2}, torch::kDouble) + 0.5;
  check("dice_loss", [&](auto const& t) { return kvision::dice_loss(t[0], labels); }, {x}, false);
  auto const dice = kvision::DiceLossOptions().micro(false).weight(weight);
  check("dice_loss, weighted", [&](auto const& t) { return kvision::dice_loss(t[0], labels, dice); }, {x}, false);
  check("tversky_loss", [&](auto const& t) { return kvision::tversky_loss(t[0], labels, 0.3, 0.6); }, {x}, false);
  for (auto const reduction : {Reduction::none, Reduction::mean, Reduction::sum}) {
    auto const focal = kvision::FocalLossOptions().reduction(reduction).weight(weight);
    check("focal_loss", [&](auto const& t) { return kvision::focal_loss(t[0], labels, focal); }, {x}, false);
    auto const binary = kvision::BinaryFocalLossOptions().reduction(reduction).pos_weight(weight);
    check(
        "binary_focal_loss_with_logits",
        [&](auto const& t) { return kvision::binary_focal_loss_with_logits(t[0], t[1], binary); }, {x, other}, false);
    check(
        "hausdorff_er_loss", [&](auto const& t) { return kvision::hausdorff_er_loss(t[0], hinge, 1, 3, reduction); },
        {3 * x}, false);
    check("welsch_loss", [=](auto const& t) { return kvision::welsch_loss(t[0], t[1], reduction); }, {x, other}, false);
    check(
        "charbonnier_loss", [=](auto const& t) { return kvision::charbonnier_loss(t[0], t[1], reduction); }, {x, other},
        false);
    check("cauchy_loss", [=](auto const& t) { return kvision::cauchy_loss(t[0], t[1], reduction); }, {x, other}, false);
    check(
        "geman_mcclure_loss", [=](auto const& t) { return kvision::geman_mcclure_loss(t[0], t[1], reduction); },
        {x, other}, false);
    check(
        "aepe", [=](auto const& t) { return kvision::aepe(t[0], t[1], reduction); },
        {torch::rand({2, 5, 2}), torch::rand({2, 5, 2})}, false);
    check(
        "ssim_loss", [=](auto const& t) { return kvision::ssim_loss(t[0], t[1], 3, 1, 1e-12, reduction); }, {x, other},
        false);
    check("total_variation", [=](auto const& t) { return kvision::total_variation(t[0], reduction); }, {x}, false);
    check(
        "js_div_loss_2d", [=](auto const& t) { return kvision::js_div_loss_2d(t[0], t[1], reduction); },
        {x + 0.5, other + 0.5}, false);
    check(
        "kl_div_loss_2d", [=](auto const& t) { return kvision::kl_div_loss_2d(t[0], t[1], reduction); },
        {x + 0.5, other + 0.5}, false);
  }
  check("lovasz_softmax_loss", [&](auto const& t) { return kvision::lovasz_softmax_loss(t[0], labels); }, {x}, false);
  check(
      "lovasz_hinge_loss", [&](auto const& t) { return kvision::lovasz_hinge_loss(t[0], labels); }, {x.narrow(1, 0, 1)},
      false);
  check("ssim", [](auto const& t) { return kvision::ssim(t[0], t[1], 5); }, {x, other}, false);
  check("ssim of one", [&](auto const& t) { return kvision::ssim(t[0], other, 5); }, {x}, false);
  auto const scales = kvision::MsSsimLossOptions().sigmas({0.5, 1});
  check("ms_ssim_loss", [&](auto const& t) { return kvision::ms_ssim_loss(t[0], t[1], scales); }, {x, other}, false);
  check("ms_ssim_loss of one", [&](auto const& t) { return kvision::ms_ssim_loss(t[0], other, scales); }, {x}, false);
  check("psnr", [](auto const& t) { return kvision::psnr(t[0], t[1], 1); }, {x, other}, false);
  check("psnr_loss", [](auto const& t) { return kvision::psnr_loss(t[0], t[1]); }, {x, other}, false);
  check(
      "inverse_depth_smoothness_loss", [](auto const& t) { return kvision::inverse_depth_smoothness_loss(t[0], t[1]); },
      {x.slice(1, 1), x * 2}, false);
  auto const bins = kvision::MutualInformationOptions().num_bins(5);
  check(
      "mutual_information_loss", [&](auto const& t) { return kvision::mutual_information_loss_2d(t[0], t[1], bins); },
      {x, other}, false);
  check(
      "normalized_mutual_information_loss",
      [&](auto const& t) { return kvision::normalized_mutual_information_loss(t[0], t[1], bins); },
      {x.flatten(1), other.flatten(1)}, false);
  Tensor const element = torch::ones({3, 3});
  check("dilation", [&](auto const& t) { return kvision::dilation(t[0], element); }, {x}, false);
  check("erosion", [&](auto const& t) { return kvision::erosion(t[0], element); }, {x}, false);
  auto const heights = kvision::MorphologyOptions().structuring_element(0.1 * torch::rand({3, 3})).border_value(0.);
  check("gradient", [&](auto const& t) { return kvision::gradient(t[0], element, heights); }, {x}, false);
  check("extract_tensor_patches",
        [](auto const& t) { return kvision::extract_tensor_patches(t[0], {3, 4}, {2, 3}, {1, 2}); }, {x});
  check("combine_tensor_patches",
        [](auto const& t) { return kvision::combine_tensor_patches(t[0], {5, 6}, {3, 4}, {2, 2}); },
        {torch::rand({1, 4, 2, 3, 4})});

  // --- geometry/transform

  Tensor const matrix = torch::tensor({0.93, 0.21, 0.4, -0.17, 1.04, 0.3, 0.013, -0.011, 1.0}).view({1, 3, 3});
  Tensor const map = torch::rand({2, 3, 4}) * 0.8 + torch::randint(0, 5, {2, 3, 4}) + 0.1;
  for (auto const mode : {Interpolation::bilinear, Interpolation::bicubic}) {
    auto const warp = [=](auto const& t) {
      auto const fill = kvision::WarpOptions().mode(mode).padding_mode(kvision::PaddingMode::fill).fill_value(t[2]);
      return kvision::warp_perspective(t[0], t[1], {5, 4}, fill);
    };
    check("warp_perspective", warp, {x, matrix, torch::rand({1, 2})}, false);
    check(
        "warp_affine",
        [=](auto const& t) { return kvision::warp_affine(t[0], t[1], {5, 4}, kvision::WarpOptions().mode(mode)); },
        {x, matrix.narrow(1, 0, 2)}, false);
    check(
        "remap", [=](auto const& t) { return kvision::remap(t[0], t[1], t[2], kvision::RemapOptions().mode(mode)); },
        {x, map, map.flip(1).contiguous()}, false);
    check(
        "remap with a fill",
        [=](auto const& t) { return ops::remap(t[0], t[1], t[2], t[3], {}, int64_t(mode), 0, true, false, false); },
        {x, map, map.flip(1).contiguous(), torch::rand({2, 1})}, false);
    auto const resize = kvision::ResizeOptions().interpolation(mode);
    check("resize", [=](auto const& t) { return kvision::resize(t[0], {3, 8}, resize); }, {x});
  }
  check(
      "homography_warp", [](auto const& t) { return kvision::homography_warp(t[0], t[1], {5, 4}); }, {x, 0.8 * matrix},
      false);
  check("affine", [](auto const& t) { return kvision::affine(t[0], t[1]); }, {x, matrix.narrow(1, 0, 2)}, false);
  check(
      "rotate", [](auto const& t) { return kvision::rotate(t[0], t[1], t[2]); },
      {x, 100 * torch::rand({2}), torch::rand({1, 2}) + 3}, false);
  check("translate", [](auto const& t) { return kvision::translate(t[0], t[1]); }, {x, torch::rand({1, 2})}, false);
  check("scale", [](auto const& t) { return kvision::scale(t[0], t[1]); }, {x, torch::rand({2, 2}) + 0.5}, false);
  check("shear", [](auto const& t) { return kvision::shear(t[0], t[1]); }, {x, 0.5 * torch::rand({2, 2})}, false);
  Tensor const quads = torch::tensor({1., 1., 4., 1.2, 4.3, 5., 0.7, 4.}).view({1, 4, 2}) + torch::rand({2, 4, 2});
  check(
      "crop_and_resize", [](auto const& t) { return kvision::crop_and_resize(t[0], t[1], {4, 3}); }, {x, quads}, false);
  check("center_crop by half a pixel", [](auto const& t) { return kvision::center_crop(t[0], {4, 5}); }, {x}, false);
  check("center_crop", [](auto const& t) { return kvision::center_crop(t[0], {5, 4}); }, {x});
  check("crop beyond the image", [](auto const& t) { return ops::crop(t[0], {-1, 1}, {4, 5}); }, {x});
  check("hflip", [](auto const& t) { return kvision::hflip(t[0]); }, {x});
  check(
      "elastic_transform2d",
      [](auto const& t) {
        auto const options = kvision::ElasticTransformOptions().kernel_size(3).sigma(1.5).align_corners(true);
        return kvision::elastic_transform2d(t[0], t[1], options);
      },
      {x, 0.02 * torch::rand({2, 2, 7, 6}) + 0.05}, false);
  check("pyrdown", [](auto const& t) { return kvision::pyrdown(t[0]); }, {x});
  check("build_laplacian_pyramid", [](auto const& t) { return kvision::build_laplacian_pyramid(t[0], 1)[0]; },
        {torch::rand({1, 2, 6, 8})});
  Tensor const affine3d = torch::tensor({0.9, 0.2, 0.1, 0.3, -0.2, 1.1, 0.1, 0.2, 0.1, -0.1, 0.8, 0.4}).view({1, 3, 4});
  check(
      "warp_affine3d", [](auto const& t) { return kvision::warp_affine3d(t[0], t[1], {2, 4, 3}); },
      {torch::rand({2, 1, 3, 4, 5}), affine3d}, false);
  check(
      "rotate3d", [](auto const& t) { return kvision::rotate3d(t[0], t[1], t[1], t[2], t[3]); },
      {volume, 100 * torch::rand({1}), 50 * torch::rand({1}), torch::rand({1, 3}) + 2}, false);
  auto const l2 = kvision::PhotometricOptions().distance(Distance::l2);
  check(
      "photometric_homography_loss",
      [&](auto const& t) { return kvision::photometric_homography_loss(to_double(x), 2 + to_double(x), t[0], l2); },
      {matrix}, false);
  variable_list const spline{torch::rand({2, 5, 2}), torch::rand({2, 5, 2}), torch::rand({1, 3, 2})};
  check(
      "warp_points_tps", [](auto const& t) { return kvision::warp_points_tps(t[0], t[1], t[2], t[3]); },
      {torch::rand({2, 4, 2}), spline[0], spline[1], spline[2]}, false);
  check(
      "warp_image_tps", [](auto const& t) { return kvision::warp_image_tps(t[0], t[1], 0.1 * t[2], 0.1 * t[3], true); },
      {x, spline[0], spline[1], spline[2]}, false);
  check(
      "get_tps_transform",
      [](auto const& t) {
        auto const [weights, affine] = kvision::get_tps_transform(t[0], t[1]);
        return torch::cat({weights, affine}, 1);
      },
      {spline[0], spline[1]}, false);
  Tensor const two = torch::rand({2, 2}), angle = 100 * torch::rand({2}), tangent = torch::rand({2});
  check(
      "get_rotation_matrix2d", [](auto const& t) { return kvision::get_rotation_matrix2d(t[0], t[1], t[2]); },
      {two, angle, two + 0.5}, false);
  check(
      "get_affine_matrix2d", [](auto const& t) { return kvision::get_affine_matrix2d(t[0], t[1], t[2], t[3], t[4]); },
      {torch::rand({1, 2}), two, two + 0.5, angle, tangent}, false);
  check(
      "get_shear_matrix2d", [](auto const& t) { return kvision::get_shear_matrix2d(t[0], none, t[1]); }, {two, tangent},
      false);
  check(
      "get_translation_matrix2d", [](auto const& t) { return kvision::get_translation_matrix2d(t[0]); }, {two}, false);
  check(
      "invert_affine_transform", [](auto const& t) { return kvision::invert_affine_transform(t[0]); },
      {matrix.narrow(1, 0, 2)}, false);
  check(
      "get_perspective_transform", [](auto const& t) { return kvision::get_perspective_transform(t[0], t[1]); },
      {quads, quads + 0.3 * torch::rand({2, 4, 2})}, false);
  check(
      "get_projective_transform", [](auto const& t) { return kvision::get_projective_transform(t[0], t[1], t[2]); },
      {torch::rand({2, 3}), 90 * torch::rand({2, 3}), torch::rand({2, 3}) + 0.5}, false);
  check(
      "translation_matrix3d", [](auto const& t) { return ops::translation_matrix3d(t[0], 1, 2, 3, 3); },
      {torch::rand({2, 3})}, false);
  check("crop_box_checks", [](auto const& t) { return ops::crop_box_checks(t[0], t[1]); }, {quads, quads + 1}, false);
  check(
      "shear_matrix3d", [](auto const& t) { return ops::shear_matrix3d(t[0], t[1], none, none, t[2], none, none); },
      {torch::rand({2, 3}), tangent, torch::rand({1})}, false);
  Tensor const box =
      torch::tensor({0., 0., 0., 2., 0., 0., 2., 3., 0., 0., 3., 0., 0., 0., 4., 2., 0., 4., 2., 3., 4., 0., 3., 4.})
          .view({1, 8, 3});
  check(
      "get_perspective_transform3d", [](auto const& t) { return kvision::get_perspective_transform3d(t[0], t[1]); },
      {box + 0.2 * torch::rand({2, 8, 3}), box + 0.2 * torch::rand({2, 8, 3})}, false);

  // --- geometry/subpix and depth

  check("nms2d", [](auto const& t) { return kvision::nms2d(t[0], 3); }, {x});
  check("nms3d", [](auto const& t) { return kvision::nms3d(t[0], 3); }, {volume});
  check(
      "render_gaussian2d", [](auto const& t) { return kvision::render_gaussian2d(t[0], t[1], {5, 6}); },
      {torch::rand({3, 2}) - 0.5, torch::rand({1, 2}) + 0.5}, false);
  check("spatial_expectation2d", [](auto const& t) { return kvision::spatial_expectation2d(t[0]); }, {x}, false);
  check("spatial_soft_argmax2d", [](auto const& t) { return kvision::spatial_soft_argmax2d(t[0], 0.5); }, {x}, false);
  auto const both = [](std::tuple<Tensor, Tensor> const& peaks) {
    auto const& [positions, values] = peaks;
    return torch::cat({positions.flatten(2, 3), values}, 2);
  };
  auto const softmax = kvision::ConvSoftArgmaxOptions<3>().stride({1, 2, 1}).temperature(0.5);
  check(
      "conv_soft_argmax3d", [&](auto const& t) { return both(kvision::conv_soft_argmax3d(t[0], softmax)); },
      {torch::rand({1, 2, 3, 5, 4})}, false);
  check("conv_soft_argmax2d", [](auto const& t) { return std::get<0>(kvision::conv_soft_argmax2d(t[0])); }, {x}, false);
  check(
      "conv_quad_interp3d", [&](auto const& t) { return both(kvision::conv_quad_interp3d(t[0])); },
      {torch::rand({1, 2, 4, 6, 5})}, false);
  Tensor const depth = torch::rand({2, 1, 5, 4}) + 1;
  Tensor const camera = torch::tensor({9.0, 0.0, 2.1, 0.0, 8.0, 2.4, 0.0, 0.0, 1.0}).view({1, 3, 3});
  check("depth_to_3d", [](auto const& t) { return kvision::depth_to_3d(t[0], t[1], true); }, {depth, camera}, false);
  check(
      "depth_to_3d_v2", [](auto const& t) { return kvision::depth_to_3d_v2(t[0], t[1]); }, {depth.squeeze(1), camera},
      false);
  check(
      "depth_to_normals", [](auto const& t) { return kvision::depth_to_normals(t[0], t[1]); }, {depth, camera}, false);
  check(
      "depth_to_normals of depth", [&](auto const& t) { return kvision::depth_to_normals(t[0], to_double(camera)); },
      {depth}, false);
  check(
      "depth_from_plane_equation",
      [](auto const& t) { return kvision::depth_from_plane_equation(t[0], t[1], t[2], t[3]); },
      {torch::rand({2, 3}) + 0.5, torch::rand({2, 1}) + 0.5, torch::rand({2, 5, 2}), matrix.expand({2, 3, 3})}, false);
  Tensor const projection = torch::cat({matrix, torch::tensor({0.11, -0.07, 0.03}).view({1, 3, 1})}, 2);
  check(
      "depth_warp",
      [](auto const& t) { return ops::depth_warp(t[0], t[1], t[2], int64_t(Interpolation::bilinear), 0, true); },
      {x, depth, projection}, false);
  check(
      "reprojection", [](auto const& t) { return ops::reprojection(t[0], t[1], t[2], t[3], true); },
      {matrix + 1, torch::rand({2, 4, 4}), matrix + 2, torch::rand({1, 4, 4})}, false);
  Tensor const motion = torch::eye(4).unsqueeze(0) + 0.02 * torch::rand({2, 4, 4});
  check(
      "warp_frame_depth", [&](auto const& t) { return kvision::warp_frame_depth(t[0], t[1], t[2], to_double(camera)); },
      {x, depth, motion}, false);
  Tensor const views = to_double(torch::rand({2, 2, 3, 7, 6})), target = to_double(torch::rand({2, 3, 5, 4}));
  check(
      "photometric_depth_loss",
      [&](auto const& t) {
        return kvision::photometric_depth_loss(views, target, t[0], t[1].expand({-1, 2, -1, -1}), Distance::l2);
      },
      {depth, projection.unsqueeze(1)}, false);

  // --- geometry/conversions

  Tensor const three = torch::rand({2, 3}), quaternion = torch::rand({2, 4}) - 0.2,
               points = torch::rand({2, 5, 3}) + 0.5;
  Tensor const rotations = kvision::axis_angle_to_rotation_matrix(to_double(three)), pose = torch::rand({2, 4, 4});
  check(
      "axis_angle_to_rotation_matrix", [](auto const& t) { return kvision::axis_angle_to_rotation_matrix(t[0]); },
      {three}, false);
  check(
      "axis_angle_to_quaternion", [](auto const& t) { return kvision::axis_angle_to_quaternion(t[0]); }, {three},
      false);
  check("quaternion_log_to_exp", [](auto const& t) { return kvision::quaternion_log_to_exp(t[0]); }, {three}, false);
  for (auto const function :
       {kvision::quaternion_exp_to_log, kvision::quaternion_to_axis_angle, kvision::quaternion_to_rotation_matrix})
    check("a quaternion's conversion", [=](auto const& t) { return function(t[0]); }, {quaternion}, false);
  for (auto const function : {kvision::rotation_matrix_to_quaternion, kvision::rotation_matrix_to_axis_angle})
    check("a rotation's conversion", [=](auto const& t) { return function(t[0]); }, {rotations}, false);
  check("normalize_quaternion", [](auto const& t) { return kvision::normalize_quaternion(t[0]); }, {quaternion}, false);
  check(
      "quaternion_product", [](auto const& t) { return ops::quaternion_product(t[0], t[1]); },
      {quaternion, torch::rand({1, 4})}, false);
  check(
      "angle_to_rotation_matrix", [](auto const& t) { return kvision::angle_to_rotation_matrix(t[0]); }, {angle},
      false);
  check(
      "quaternion_from_euler",
      [](auto const& t) { return std::get<1>(kvision::quaternion_from_euler(t[0], t[1], t[2])); },
      {tangent, tangent + 0.2, torch::rand({2})}, false);
  check(
      "euler_from_quaternion",
      [](auto const& t) { return std::get<2>(kvision::euler_from_quaternion(t[0], t[1], t[2], t[3])); },
      {tangent + 1, 0.2 * tangent, 0.3 * torch::rand({2}), 0.3 * torch::rand({2})}, false);
  check("se2_exp", [](auto const& t) { return kvision::se2_exp(t[0]); }, {three}, false);
  check("se2_log", [](auto const& t) { return kvision::se2_log(t[0]); }, {quaternion}, false);
  Tensor const six = torch::cat({three, 0.5 * three.roll(1, 1)}, 1);
  for (auto const function : {kvision::so3_left_jacobian, kvision::so3_left_jacobian_inverse})
    check("a Jacobian of SO(3)", [=](auto const& t) { return function(t[0]); }, {three}, false);
  for (auto const function : {kvision::se3_exp, kvision::se3_left_jacobian, kvision::se3_left_jacobian_inverse})
    check("a map of SE(3)", [=](auto const& t) { return function(t[0]); }, {six}, false);
  check("se3_log", [](auto const& t) { return kvision::se3_log(t[0]); }, {torch::cat({quaternion, three}, 1)}, false);
  check(
      "vector_to_skew_symmetric_matrix", [](auto const& t) { return kvision::vector_to_skew_symmetric_matrix(t[0]); },
      {three}, false);
  check(
      "compose_transformations", [](auto const& t) { return kvision::compose_transformations(t[0], t[1]); },
      {pose, pose + 1}, false);
  check("inverse_transformation", [](auto const& t) { return kvision::inverse_transformation(t[0]); }, {pose}, false);
  check(
      "relative_transformation", [](auto const& t) { return kvision::relative_transformation(t[0], t[1]); },
      {pose, pose + 1}, false);
  check(
      "transform_points", [](auto const& t) { return kvision::transform_points(t[1], t[0]); },
      {points, torch::rand({2, 4, 4}) + 0.5}, false);
  check(
      "project_points", [](auto const& t) { return kvision::project_points(t[0], t[1]); }, {points, matrix + 1}, false);
  check(
      "unproject_points", [](auto const& t) { return kvision::unproject_points(t[0], t[1], t[2], true); },
      {torch::rand({2, 5, 2}), torch::rand({2, 5, 1}), matrix + 1}, false);

  // --- geometry/homography, epipolar and calibration

  Tensor const from = torch::rand({2, 9, 2}), to = torch::rand({2, 9, 2}), weights = torch::rand({2, 9});
  Tensor const equations = torch::rand({2, 11, 9}) - 0.5, segments = torch::rand({2, 6, 2, 2});
  auto const pairs =
      torch::stack({torch::tensor({0.3, 0.5, 0.2, 0.6}), torch::tensor({0.9, 0.8, 0.7, 0.95})}, -1).unsqueeze(0);
  auto const neighbors = torch::tensor({1, 2, 0, 3, 3, 1, 2, 0}).view({1, 4, 2});
  for (bool const ratios : {false, true})
    check(
        "select_matches",
        [=](auto const& t) {
          return std::get<0>(
              ops::select_matches(t[0], neighbors, t[1], neighbors, 4, ratios, ratios ? 0.99 : INFINITY));
        },
        {pairs, pairs * 0.9}, false);

  check("null_vector", [](auto const& t) { return ops::null_vector(t[0], none); }, {equations}, false);
  check(
      "null_vector of weights", [](auto const& t) { return ops::null_vector(t[0], t[1]); },
      {equations, torch::rand({2, 11}) + 0.5}, false);
  for (auto const fit : {kvision::find_homography_dlt, kvision::find_fundamental}) {
    check("a fit", [=](auto const& t) { return fit(t[0], t[1], none); }, {from, to}, false);
    check("a fit of weights", [=](auto const& t) { return fit(t[0], t[1], t[2]); }, {from, to, weights + 0.5}, false);
  }
  check("affine_fit", [](auto const& t) { return ops::affine_fit(t[0], t[1], none); }, {from, to}, false);
  check(
      "affine_fit of weights", [](auto const& t) { return ops::affine_fit(t[0], t[1], t[2]); },
      {from, to, weights + 0.5}, false);
  check(
      "find_homography_lines_dlt", [](auto const& t) { return kvision::find_homography_lines_dlt(t[0], t[1], t[2]); },
      {segments, torch::rand({2, 6, 2, 2}), torch::rand({2, 6}) + 0.5}, false);
  check(
      "normalize_points",
      [](auto const& t) {
        auto const [points, matrix] = kvision::normalize_points(t[0], 1e-8, t[1]);
        return torch::cat({points, matrix.narrow(2, 0, 2) + matrix.narrow(2, 1, 2)}, 1);
      },
      {from, weights + 0.5}, false);
  Tensor const pinhole = 2 * torch::eye(3).repeat({2, 1, 1}), solid = torch::rand({2, 9, 3}) + 1;
  check(
      "solve_pnp_dlt", [](auto const& t) { return kvision::solve_pnp_dlt(t[0], t[1], t[2]); }, {solid, from, pinhole},
      false);
  check(
      "solve_pnp_dlt of weights", [](auto const& t) { return kvision::solve_pnp_dlt(t[0], t[1], t[2], t[3]); },
      {solid, from, pinhole, weights + 0.5}, false);
  Tensor const matrices = torch::rand({2, 3, 3});
  for (int64_t kind = 0; kind < int64_t(ops::CorrespondenceError::segments); ++kind)
    check(
        "correspondence_errors",
        [=](auto const& t) { return ops::correspondence_errors(t[0], t[1], t[2], kind, true); },
        {from, torch::rand({1, 9, 3}) + 0.5, matrices + 1}, false);
  check(
      "line_segment_transfer_error_one_way",
      [](auto const& t) { return kvision::line_segment_transfer_error_one_way(t[0], t[1], t[2]); },
      {segments, segments.flip(1), matrices.narrow(0, 0, 1) + 1}, false);
  check("project_to_essential", [](auto const& t) { return kvision::project_to_essential(t[0]); }, {matrices}, false);
  check(
      "rotations", [](auto const& t) { return std::get<0>(kvision::motion_from_essential(t[0])); }, {matrices}, false);
  check(
      "directions", [](auto const& t) { return std::get<2>(kvision::decompose_essential_matrix(t[0])); }, {matrices},
      false);
  for (auto const function : {kvision::fundamental_from_essential, kvision::essential_from_fundamental})
    check(
        "essential and fundamental", [=](auto const& t) { return function(t[0], t[1], t[2]); },
        {matrices, pinhole + matrices, pinhole + 0.5 * matrices}, false);
  Tensor const projections = torch::rand({2, 3, 4});
  check(
      "fundamental_from_projections", [](auto const& t) { return kvision::fundamental_from_projections(t[0], t[1]); },
      {projections, projections + torch::rand({2, 3, 4})}, false);
  check(
      "KRt_from_projection", [](auto const& t) { return std::get<1>(kvision::KRt_from_projection(t[0])); },
      {projections + torch::eye(3, 4)}, false);
  Tensor const translation = torch::rand({2, 3, 1});
  check(
      "essential_from_Rt", [](auto const& t) { return kvision::essential_from_Rt(t[0], t[1], t[2], t[3]); },
      {matrices, translation, matrices + 1, translation + 1}, false);
  check(
      "relative_camera_motion",
      [](auto const& t) { return std::get<1>(kvision::relative_camera_motion(t[0], t[1], t[2], t[3])); },
      {matrices, translation, matrices + 1, translation + 1}, false);
  Tensor const still = torch::eye(3, 4).expand({2, 3, 4}),
               moved = torch::cat({still.narrow(2, 0, 3), still.narrow(2, 0, 1)}, 2),
               shift = torch::tensor({0.5f, 0.f});
  check(
      "triangulate_points", [](auto const& t) { return kvision::triangulate_points(t[2], t[3], t[0], t[1]); },
      {from, from + shift, still, moved}, false);
  Tensor const lens = torch::tensor({2.f, 0.f, 0.f, 0.f, 2.f, 0.f, 0.f, 0.f, 1.f}).view({1, 3, 3});
  Tensor const ideal = torch::tensor({4.f, 0.f, 1.f, 0.f, 4.f, 1.f, 0.f, 0.f, 1.f}).view({1, 3, 3});
  Tensor const terms = 0.03 * torch::rand({2, 14});
  check("undistort_points", [](auto const& t) { return kvision::undistort_points(t[0], t[1], t[3], t[2], 10); },
        {from, lens.repeat({2, 1, 1}), ideal, terms});
  check("distort_points", [](auto const& t) { return kvision::distort_points(t[0], t[1], t[3], t[2]); },
        {from, lens.repeat({2, 1, 1}), ideal, terms});
  check(
      "undistort_image", [&](auto const& t) { return kvision::undistort_image(to_double(x), t[0], t[1]); },
      {torch::rand({1, 3, 3}) + 3, 0.01 * torch::rand({2, 8})}, false);
  check(
      "undistort_map of a tilted sensor", [](auto const& t) { return ops::undistort_map(t[0], t[1], t[2], {3, 5}); },
      {torch::rand({1, 3, 3}) + 3, 0.1 * torch::rand({2, 14}), torch::eye(3) + 0.1 * torch::rand({2, 3, 3})}, false);

  // --- features

  torch::manual_seed(0);  // the functions have kinks, which few pixels rarely meet
  Tensor const gray = torch::rand({1, 1, 8, 8}) + 0.2 * torch::arange(8);
  Tensor const frames = torch::cat({3 * torch::eye(2) + torch::rand({1, 3, 2, 2}), 4 + torch::rand({1, 3, 2, 1})}, 3);
  for (auto const extract : {&kvision::extract_patches_simple, &kvision::extract_patches_from_pyramid})
    check("extract_patches", [=](auto const& t) { return extract(t[0], t[1], 4); }, {gray, frames}, false);
  check(
      "sift_descriptor",
      [](auto const& t) {
        return kvision::sift_descriptor(t[0], kvision::SiftOptions().num_spatial_bins(2).rootsift(false));
      },
      {gray}, false);
  check("dominant_orientation", [](auto const& t) { return kvision::dominant_orientation(t[0]); }, {gray}, false);
  check("affine_shape", [](auto const& t) { return kvision::affine_shape(t[0]); }, {gray}, false);

  std::cout << checks << " derivatives, " << failures << " failures\n";
  return failures > 0;
}
