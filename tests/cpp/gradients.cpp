// Every function of the C++ API on small tensors: its gradients against central differences, and, where it has them,
// its second derivatives. Prints the names of those that fail.
#include <kvision/kvision.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/types.h>

#include <cmath>
#include <functional>
#include <iostream>

using torch::Tensor;
using torch::autograd::variable_list;
using Function = std::function<Tensor(variable_list const&)>;

namespace {

int checks = 0, failures = 0;

// The gradients of sum(w f(x)^2) for fixed random weights w.
variable_list gradients(Function const& f, variable_list const& inputs, bool create_graph = false) {
  torch::manual_seed(1);
  Tensor const y = f(inputs);
  Tensor const loss = (torch::rand_like(y) * y * y).sum();
  return torch::autograd::grad({loss}, inputs, {}, std::nullopt, create_graph);
}

// The derivative of scalar function `f` along random directions, against what `slopes` says of it.
void compare(std::string const& name, std::function<double(variable_list const&)> const& f, variable_list const& inputs,
             variable_list const& slopes) {
  for (size_t i = 0; i < inputs.size(); ++i, ++checks) {
    torch::NoGradGuard no_grad;
    Tensor const step = 1e-5 * torch::randn_like(inputs[i]);
    variable_list before = inputs, after = inputs;
    before[i] = (inputs[i] - step).requires_grad_();
    after[i] = (inputs[i] + step).requires_grad_();
    double const numeric = (f(after) - f(before)) / 2, analytic = (slopes[i] * step).sum().item<double>();
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
  Tensor const x = torch::rand({2, 2, 7, 6}), volume = torch::rand({1, 2, 5, 4, 6});
  Tensor const row = torch::rand({1, 3}), column = torch::rand({2, 5}), sigma = torch::rand({2, 2}) + 0.5;

  check("ssim", [](auto const& t) { return kvision::ssim(t[0], t[1], 5); }, {x, torch::rand_like(x)}, false);
  check(
      "extract_patches",
      [](auto const& t) { return kvision::extract_patches(t[0], {7, 6}, {3, 4}, {2, 3}, {1, 0, 2, 1}); }, {x}, true);
  check("ssim_loss", [](auto const& t) { return kvision::ssim_loss(t[0], t[1], 3); }, {x, torch::rand_like(x)}, false);
  check(
      "ms_ssim", [](auto const& t) { return kvision::ms_ssim(t[0], t[1], {0.5, 1}, 5); }, {x, torch::rand_like(x)},
      false);
  check(
      "dilation",
      [](auto const& t) { return kvision::dilation(t[0], torch::ones({1, 3, 3}, torch::kDouble), {}, 1, 1); }, {x},
      false);
  Tensor const labels = torch::randint(0, 2, {1, 2, 7, 6});
  check("focal", [&](auto const& t) { return kvision::focal(t[0], labels); }, {x.unsqueeze(0)}, false);
  check("overlap", [&](auto const& t) { return std::get<0>(kvision::overlap(t[0], labels)); }, {x.unsqueeze(0)}, false);
  check("lovasz", [&](auto const& t) { return std::get<0>(kvision::lovasz(t[0], labels[0])); }, {x}, false);
  check("hausdorff", [&](auto const& t) { return kvision::hausdorff(t[0], labels[0], 1, 3); }, {3 * x}, false);
  Tensor const rows = x.flatten(1), others = torch::rand_like(rows) + 0.5;
  check(
      "pointwise_loss", [](auto const& t) { return kvision::pointwise_loss(t[0], t[1], "welsch"); }, {rows, others},
      false);
  check(
      "pointwise_sum", [](auto const& t) { return kvision::pointwise_sum(t[0], t[1], "js", 0.1); },
      {rows + 0.5, others}, false);
  check(
      "mutual_information",
      [](auto const& t) { return std::get<0>(kvision::mutual_information(t[0], t[1], {}, {}, "xu", 5)); },
      {rows, others}, false);
  check("binary_focal", [](auto const& t) { return kvision::binary_focal(t[0], t[1]); }, {rows, others}, false);
  check(
      "endpoint_error", [](auto const& t) { return kvision::endpoint_error(t[0], t[1], false, true, 0.5); },
      {torch::rand({2, 5, 2}), torch::rand({2, 5, 2})}, false);
  check("total_variation", [](auto const& t) { return kvision::total_variation(t[0], 0.5, 2); }, {x}, false);
  check(
      "smoothness", [](auto const& t) { return kvision::smoothness(t[0], t[1], 0.5, 2); }, {x.slice(1, 1), x * 2},
      false);
  Tensor const matrix = torch::tensor({0.93, 0.21, 0.4, -0.17, 1.04, 0.3, 0.013, -0.011, 1.0}).view({1, 3, 3});
  Tensor const map = torch::rand({2, 3, 4}) * 0.8 + torch::randint(0, 5, {2, 3, 4}) + 0.1;
  for (auto const* interpolation : {"bilinear", "bicubic"}) {
    check(
        "warp", [&](auto const& t) { return kvision::warp(t[0], t[1], t[2], {5, 4}, interpolation); },
        {x, matrix, torch::rand({1, 2})}, false);
    check(
        "remap", [&](auto const& t) { return kvision::remap(t[0], t[1], t[2], t[3], interpolation); },
        {x, map, map.flip(1).contiguous(), torch::rand({2, 1})}, false);
  }
  check(
      "moves",
      [&](auto const& t) { return kvision::remap(t[0], t[1], t[2], {}, "bilinear", "fill", true, true, true); },
      {x, 0.1 * torch::rand({2, x.size(2), x.size(3)}) + 0.3, 0.1 * torch::rand({1, x.size(2), x.size(3)}) - 0.4},
      false);
  variable_list const spline{torch::rand({2, 5, 2}), torch::rand({2, 5, 2}), torch::rand({1, 3, 2})};
  check("spline_map", [](auto const& t) { return kvision::spline_map(t[0], t[1], t[2], {3, 4}); }, spline, false);
  check(
      "spline_points", [](auto const& t) { return kvision::spline_points(t[0], t[1], t[2], t[3]); },
      {torch::rand({2, 4, 2}), spline[0], spline[1], spline[2]}, false);
  check(
      "spline_weights", [](auto const& t) { return kvision::spline_weights(t[0], t[1]); },
      {spline[0], torch::rand({2, 8, 2})}, false);
  for (auto const* window : {"bilinear", "bicubic", "pyrdown"})
    check("resize", [=](auto const& t) { return kvision::resize(t[0], {3, 8}, window); }, {x});
  check("flip", [](auto const& t) { return kvision::flip(t[0], true, false); }, {x});
  check("window", [](auto const& t) { return kvision::window(t[0], {-1, 1}, {4, 5}); }, {x});
  check("pyramid_detail", [](auto const& t) { return kvision::pyramid_detail(t[0], t[1]); },
        {x, torch::rand({x.size(0), x.size(1), 2 * x.size(2), 2 * x.size(3)})});
  Tensor const turn = torch::tensor({0.9, 0.2, 0.1, 0.3, -0.2, 1.1, 0.1, 0.2, 0.1, -0.1, 0.8, 0.4}).view({1, 3, 4});
  check(
      "warp3d", [](auto const& t) { return kvision::warp3d(t[0], t[1], {2, 4, 3}); },
      {torch::rand({2, 1, 3, 4, 5}), turn}, false);
  check(
      "photometric",
      [&](auto const& t) { return kvision::photometric(x.to(torch::kDouble), 2 + x.to(torch::kDouble), t[0], "l2"); },
      {matrix}, false);
  check("local_maxima", [](auto const& t) { return std::get<0>(kvision::local_maxima(t[0], {1, 3, 3})); }, {x});
  check(
      "gaussian_maps", [](auto const& t) { return kvision::gaussian_maps(t[0], t[1], 5, 6, true); },
      {torch::rand({3, 2}) - 0.5, torch::rand({1, 2}) + 0.5}, false);
  check("mean_place", [](auto const& t) { return std::get<0>(kvision::mean_place(t[0], true, 2)); }, {x}, false);
  check(
      "soft_argmax",
      [](auto const& t) {
        auto const [places, values] = kvision::soft_argmax(t[0], {3, 3, 3}, {1, 2, 1}, {1, 1, 1}, 0.5);
        return torch::cat({places.flatten(2, 3), values}, 2);
      },
      {torch::rand({1, 2, 3, 5, 4})}, false);
  check(
      "quadratic_peaks",
      [](auto const& t) {
        auto const [places, values] = kvision::quadratic_peaks(t[0]);
        return torch::cat({places.flatten(2, 3), values}, 2);
      },
      {torch::rand({1, 2, 4, 6, 5})}, false);
  Tensor const depth = torch::rand({2, 1, 5, 4}) + 1,
               camera = torch::tensor({9.0, 0.0, 2.1, 0.0, 8.0, 2.4, 0.0, 0.0, 1.0});
  check(
      "depth_points",
      [&](auto const& t) { return kvision::depth_points(t[0], camera.view({1, 3, 3}).to(torch::kDouble), true); },
      {depth}, false);
  check(
      "depth_points, coordinates last",
      [&](auto const& t) {
        return kvision::depth_points(t[0], camera.view({1, 3, 3}).to(torch::kDouble), false, true);
      },
      {depth}, false);
  check(
      "depth_normals",
      [&](auto const& t) { return kvision::depth_normals(t[0], camera.view({1, 3, 3}).to(torch::kDouble)); }, {depth},
      false);
  Tensor const projection = torch::cat({matrix, torch::tensor({0.11, -0.07, 0.03}).view({1, 3, 1})}, 2);
  check(
      "depth_warp", [](auto const& t) { return kvision::depth_warp(t[0], t[1], t[2]); }, {x, depth, projection}, false);
  check(
      "reprojection", [](auto const& t) { return kvision::reprojection(t[0], t[1], t[2], t[3], true); },
      {matrix + 1, torch::rand({2, 4, 4}), matrix + 2, torch::rand({1, 4, 4})}, false);
  Tensor const seen = torch::rand({2, 2, 3, 7, 6}, torch::kDouble), target = torch::rand({2, 3, 5, 4}, torch::kDouble);
  check(
      "photometric_depth",
      [&](auto const& t) { return kvision::photometric_depth(seen, target, t[0], t[1].expand({-1, 2, -1, -1}), "l2"); },
      {depth, projection.unsqueeze(1)}, false);
  check(
      "axis_angle_to_rotation_matrix", [](auto const& t) { return kvision::axis_angle_to_rotation_matrix(t[0]); },
      {torch::rand({2, 3})}, false);
  check(
      "affine_matrix2d",
      [](auto const& t) { return kvision::affine_matrix2d(t[0], t[1], {}, t[2], {}, t[3], 1, 0, 0, 2); },
      {100 * torch::rand({2}), torch::rand({1, 2}), torch::rand({2}), torch::rand({2, 2})}, false);
  static constexpr auto some = std::nullopt;
  check(
      "warp_by_formula",
      [&](auto const& t) {
        return kvision::warp_by_formula(t[0], t[1], some, t[2], some, some, some, "affine_matrix2d", {1, 2, 3}, {5, 4});
      },
      {x, 100 * torch::rand({2}), torch::rand({1, 2}) + 0.5}, false);
  check(
      "warp_by_formula of numbers",
      [&](auto const& t) {
        return kvision::warp_by_formula(t[0], some, some, some, some, some, some, "translation_matrix2d", {0.3, 1.2},
                                        {5, 4});
      },
      {x}, false);
  check(
      "warp3d_by_formula",
      [&](auto const& t) {
        return kvision::warp3d_by_formula(t[0], t[1], t[1], t[1], some, some, t[2], "affine_matrix3d", {1, 0, 0, 0},
                                          {3, 5, 4});
      },
      {volume, 100 * torch::rand({1}), torch::rand({1, 3}) + 0.5}, false);
  check(
      "lens_map", [](auto const& t) { return kvision::lens_map(t[0], t[1], some, {3, 5}); },
      {torch::rand({1, 3, 3}) + 3, 0.1 * torch::rand({2, 8})}, false);
  check(
      "lens_map of a tilted sensor", [](auto const& t) { return kvision::lens_map(t[0], t[1], t[2], {3, 5}); },
      {torch::rand({1, 3, 3}) + 3, 0.1 * torch::rand({2, 14}), torch::eye(3) + 0.1 * torch::rand({2, 3, 3})}, false);
  Tensor const points = torch::rand({2, 5, 3}) + 0.5;
  check(
      "map_points", [](auto const& t) { return kvision::map_points(t[0], {}, t[1], "transform"); },
      {points, torch::rand({2, 4, 4}) + 0.5}, false);
  check(
      "map_points", [](auto const& t) { return kvision::map_points(t[0], t[1], t[2], "unproject_distance"); },
      {torch::rand({2, 5, 2}), torch::rand({2, 5, 1}), matrix + 1}, false);
  check(
      "map_points to a plane", [](auto const& t) { return kvision::map_points(t[0], {}, t[1], "meet"); },
      {torch::rand({2, 5, 2}), torch::rand({2, 1, 9}) + 0.5}, false);
  Tensor const equations = torch::rand({2, 11, 9}) - 0.5, from = torch::rand({2, 6, 2}),
               to = from + 0.1 * torch::rand({2, 6, 2});
  check("null_vector", [](auto const& t) { return kvision::null_vector(t[0]); }, {equations}, false);
  check(
      "null_vector of weights", [](auto const& t) { return kvision::null_vector(t[0], t[1]); },
      {equations, torch::rand({2, 11}) + 0.5}, false);
  check("homography_dlt", [](auto const& t) { return kvision::homography_dlt(t[0], t[1]); }, {from, to}, false);
  check(
      "homography_dlt of weights", [](auto const& t) { return kvision::homography_dlt(t[0], t[1], t[2]); },
      {from, to, torch::rand({2, 6}) + 0.5}, false);
  check(
      "homography_lines_dlt", [](auto const& t) { return kvision::homography_lines_dlt(t[0], t[1], t[2]); },
      {torch::rand({2, 6, 2, 2}), torch::rand({2, 6, 2, 2}), torch::rand({2, 6}) + 0.5}, false);
  auto const both = [](auto const& t) {
    auto const [points, matrix] = kvision::normalize_points(t[0], t[1]);
    return torch::cat({points, matrix.narrow(2, 0, 2) + matrix.narrow(2, 1, 2)}, 1);
  };
  check("normalize_points", both, {from, torch::rand({2, 6}) + 0.5}, false);
  Tensor const rotation = torch::rand({2, 3, 3}), translation = torch::rand({2, 3, 1});
  check(
      "essential_from_motions", [](auto const& t) { return kvision::essential_from_motions(t[0], t[1], t[2], t[3]); },
      {rotation, translation, rotation + 1, translation + 1}, false);
  Tensor const first = torch::rand({2, 9, 2}), second = first + 0.1 * torch::rand({2, 9, 2});
  check("fundamental_dlt", [](auto const& t) { return kvision::fundamental_dlt(t[0], t[1]); }, {first, second}, false);
  check(
      "fundamental_dlt of weights", [](auto const& t) { return kvision::fundamental_dlt(t[0], t[1], t[2]); },
      {first, second, torch::rand({2, 9}) + 0.5}, false);
  check("affine_fit", [](auto const& t) { return kvision::affine_fit(t[0], t[1]); }, {first, second}, false);
  check(
      "affine_fit of weights", [](auto const& t) { return kvision::affine_fit(t[0], t[1], t[2]); },
      {first, second, torch::rand({2, 9}) + 0.5}, false);
  Tensor const solid = torch::rand({2, 9, 3}) + 1, pinhole = 2 * torch::eye(3).repeat({2, 1, 1});
  check("pose_dlt", [](auto const& t) { return kvision::pose_dlt(t[0], t[1], t[2]); }, {solid, first, pinhole}, false);
  check(
      "pose_dlt of weights", [](auto const& t) { return kvision::pose_dlt(t[0], t[1], t[2], t[3]); },
      {solid, first, pinhole, torch::rand({2, 9}) + 0.5}, false);
  Tensor const matrices = torch::rand({3, 3, 3});
  for (auto const* kind :
       {"sampson", "symmetrical", "right", "left", "transfer", "symmetric_transfer", "sampson_transfer"})
    check(
        "view_errors", [=](auto const& t) { return kvision::view_errors(t[0], t[1], t[2], kind, true); },
        {from, torch::rand({1, 6, 3}) + 0.5, matrices.narrow(0, 0, 2) + 1}, false);
  check(
      "segments", [](auto const& t) { return kvision::view_errors(t[0], t[1], t[2], "segments", false); },
      {torch::rand({2, 6, 4}), torch::rand({2, 6, 4}), matrices.narrow(0, 0, 1) + 1}, false);
  check("nearest_essential", [](auto const& t) { return kvision::nearest_essential(t[0]); }, {matrices}, false);
  check("rotations", [](auto const& t) { return std::get<0>(kvision::essential_motions(t[0])); }, {matrices}, false);
  check("directions", [](auto const& t) { return std::get<1>(kvision::essential_motions(t[0])); }, {matrices}, false);
  check("sobel", [](auto const& t) { return kvision::sobel(t[0]); }, {x}, false);
  for (auto const* mode : {"sobel", "diff"})
    for (int order : {1, 2})
      check("spatial_gradient", [=](auto const& t) { return kvision::spatial_gradient(t[0], mode, order); }, {x});
  for (int order : {1, 2})
    check("spatial_gradient3d", [=](auto const& t) { return kvision::spatial_gradient3d(t[0], order); }, {volume});

  for (auto const* border : {"constant", "reflect", "replicate", "circular"}) {
    check("box_blur", [=](auto const& t) { return kvision::box_blur(t[0], 5, 3, border); }, {x});
    check("laplacian", [=](auto const& t) { return kvision::laplacian(t[0], 3, 5, true, border); }, {x});
    check("median_blur", [=](auto const& t) { return kvision::median_blur(t[0], 3, 3, border); }, {x}, false);
    auto const bilateral = [=](auto const& t) {
      return kvision::bilateral_blur(t[0], {}, {}, {}, 3, 5, 0.4, 1.5, 0.9, border);
    };
    check("bilateral_blur", bilateral, {x}, false);
    auto const joint = [=](auto const& t) {
      return kvision::bilateral_blur(t[0], t[1], t[2], t[3], 3, 5, 0, 0, 0, border, "l2");
    };
    check("bilateral_blur of all", joint, {x, torch::rand({1, 3, 7, 6}), sigma.select(1, 0), sigma}, false);
    auto const filter = [=](auto const& t) { return kvision::filter2d(t[0], t[1], border); };
    check("filter2d", filter, {x, torch::rand({1, 3, 4}) - 0.3});
    check("filter2d of a kernel each", filter, {x, torch::rand({2, 5, 3}) - 0.3});
    auto const filter_volume = [=](auto const& t) { return kvision::filter3d(t[0], t[1], border); };
    check("filter3d", filter_volume, {volume, torch::rand({1, 3, 2, 3}) - 0.3});
    auto const separable = [=](auto const& t) { return kvision::filter2d_separable(t[0], t[1], t[2], border); };
    check("filter2d_separable", separable, {x, row, column}, false);
    auto const constant = [=](auto const& t) {
      return kvision::filter2d_separable(t[0], row.to(torch::kDouble), column.to(torch::kDouble), border);
    };
    check("filter2d_separable of constant kernels", constant, {x});
    auto const blur = [=](auto const& t) { return kvision::gaussian_blur2d(t[0], {}, 5, 3, 1.5, 0.7, border); };
    check("gaussian_blur2d", blur, {x});
    auto const blur_of_variable = [=](auto const& t) {
      return kvision::gaussian_blur2d(t[0], t[1], 5, 3, 0, 0, border);
    };
    check("gaussian_blur2d of sigma", blur_of_variable, {x, sigma}, false);
    auto const sharpen = [=](auto const& t) { return kvision::unsharp_mask(t[0], {}, 5, 3, 1.5, 0.7, border); };
    check("unsharp_mask", sharpen, {x});
  }
  Tensor const colors = torch::rand({2, 3, 4, 5}) * 0.3 + torch::tensor({0.3f, 0.f, 0.6f}).view({3, 1, 1});
  using Conversion = Tensor (*)(Tensor const&);
  Conversion const there_and_back[][2] = {
      {[](Tensor const& x) { return kvision::rgb_to_hsv(x); }, kvision::hsv_to_rgb},
      {[](Tensor const& x) { return kvision::rgb_to_hls(x); }, kvision::hls_to_rgb},
      {kvision::rgb_to_linear_rgb, kvision::linear_rgb_to_rgb},
      {kvision::rgb_to_lab, [](Tensor const& x) { return kvision::lab_to_rgb(x); }},
      {[](Tensor const& x) { return kvision::rgb_to_luv(x); }, [](Tensor const& x) { return kvision::luv_to_rgb(x); }},
      {kvision::rgb_to_ycbcr, kvision::ycbcr_to_rgb},
  };
  for (auto const [there, back] : there_and_back) {
    check("a conversion", [=](auto const& t) { return there(t[0]); }, {colors}, false);
    check("its inverse", [=](auto const& t) { return back(t[0]); }, {there(colors)}, false);
    if (!torch::allclose(back(there(colors)), colors, 0, 1e-3) && ++failures) std::cout << "a conversion and back\n";
  }
  check("rgb_to_grayscale", [](auto const& t) { return kvision::rgb_to_grayscale(t[0]); }, {colors}, false);
  Tensor const luma = kvision::rgb_to_ycbcr(colors).slice(1, 0, 1);
  if (!torch::allclose(kvision::rgb_to_grayscale(colors), luma) && ++failures) std::cout << "grey is not luma\n";
  std::vector<double> const mix{0.3, 0.6, 0.1, -0.1, -0.3, 0.4, 0.6, -0.5, -0.1};
  check("split_chroma",
        [&](auto const& t) {
          auto const [luma, chroma] = kvision::split_chroma(t[0], 2, mix);
          return kvision::join_chroma(luma.square(), chroma.square(), 2, mix);
        },
        {torch::rand({2, 3, 4, 6})});
  check("mix", [](auto const& t) { return kvision::mix(t[0], t[1], t[2], {}, t[3], 0, 0.3, 0); },
        {x, torch::rand_like(x), torch::rand({2, 1, 1}), torch::rand({1, 2, 1})});
  check(
      "sharpness", [](auto const& t) { return kvision::sharpness(t[0], t[1], 0); }, {x, torch::rand({2, 1, 1})}, false);
  check(
      "jpeg", [](auto const& t) { return kvision::jpeg(t[0], t[1], t[2], {}, 0); },
      {torch::rand({2, 3, 5, 6}), 20 + 50 * torch::rand({2}), 20 + 50 * torch::rand({1, 8, 8})}, false);
  check("raw_to_rgb", [](auto const& t) { return kvision::raw_to_rgb(t[0], "GB"); }, {torch::rand({2, 1, 4, 6})}, true);
  auto const contrast = [](auto const& t) {  // and gamma
    kvision::ColorProgram const program{{22, 25}, {0, 0, 0, 0.9}, {0, -1, 1, -1}, t[1], t[2]};
    return std::get<0>(kvision::color_program_around_mean(t[0], program));
  };
  check("color_program_around_mean", contrast, {colors, 0.7 + 0.5 * torch::rand({2, 1, 1}), torch::ones({1, 1, 1})},
        false);
  auto const ridges = [](auto const& t) { return std::get<0>(kvision::canny_suppress(t[0], 0.1, 0.2, 1e-6)); };
  check("canny_suppress", ridges, {x}, false);
  Tensor const edges = kvision::canny_hysteresis(torch::tensor({0.5f, 1.f, 0.f, 0.5f}).view({1, 1, 1, 4}));
  if (!torch::equal(edges, torch::tensor({1.f, 1.f, 0.f, 0.f}).view({1, 1, 1, 4})) && ++failures)
    std::cout << "canny_hysteresis: " << edges << "\n";

  auto const stretch = [](auto const& t) { return std::get<0>(kvision::normalize_min_max(t[0], -1, 2)); };
  check("normalize_min_max", stretch, {x}, false);
  auto const counts = [&](auto const& t) {
    return kvision::gaussian_counts(t[0], row.to(torch::kDouble), torch::full({1}, 0.2, torch::kDouble));
  };
  check("gaussian_counts", counts, {column}, false);
  check("grid_counts", [](auto const& t) { return kvision::grid_counts(t[0], 0, 0.25, 4); }, {column}, false);
  // What has no gradient in C++ says so instead of giving none.
  auto const without = [](std::string const& name, Tensor const& found, Tensor const& expected) {
    if (!torch::allclose(found, expected, 0, 1e-5) && ++failures) std::cout << name << ": " << found << "\n";
    try {
      found.sum().backward();
      std::cout << name << ": a gradient without an error\n";
      ++failures;
    } catch (c10::NotImplementedError const&) {
    }
  };
  Tensor const places = from.clone().requires_grad_(), eye = torch::eye(3).unsqueeze(0);
  without("real_roots", kvision::real_roots(torch::tensor({{1.f, -3.f, 2.f}}).requires_grad_()),
          torch::tensor({{1.f, 2.f}}));
  Tensor const lens = torch::tensor({2.f, 0.f, 0.f, 0.f, 2.f, 0.f, 0.f, 0.f, 1.f}).view({1, 3, 3});
  Tensor const wanted = torch::tensor({4.f, 0.f, 1.f, 0.f, 4.f, 1.f, 0.f, 0.f, 1.f}).view({1, 3, 3});
  auto const same = [](std::string const& name, Tensor const& found, Tensor const& expected) {
    if (!torch::allclose(found, expected, 1e-4, 1e-5) && ++failures) std::cout << name << ": " << found << "\n";
  };
  same("undistort", kvision::undistort(from, lens, wanted, torch::zeros({1, 4})), 2 * from + 1);
  Tensor const terms = 0.1 * torch::rand({2, 12}), tilt = eye + 0.1 * torch::rand({1, 3, 3});
  same("undistort of variables", kvision::undistort(places, lens, wanted, terms, tilt).detach(),
       kvision::undistort(from, lens, wanted, terms, tilt));
  auto const undistort = [](auto const& t) { return kvision::undistort(t[0], t[1], t[2], t[3], t[4], 3); };
  check("undistort", undistort, {from, lens.repeat({2, 1, 1}), wanted, terms, tilt});
  Tensor const shown = kvision::distort(from, lens, lens, terms);
  same("distort and back", kvision::undistort(shown, lens, lens, terms, {}, 60), from);
  same("distort of variables", kvision::distort(places, lens, lens, terms).detach(), shown);
  auto const distort = [](auto const& t) { return kvision::distort(t[0], t[1], t[2], t[3], t[4]); };
  check("distort", distort, {from, lens.repeat({2, 1, 1}), wanted, terms, tilt});
  Tensor const still = torch::eye(3, 4).expand({2, 3, 4}),
               moved = torch::cat({still.narrow(2, 0, 3), still.narrow(2, 0, 1)}, 2);
  Tensor const shift = torch::tensor({0.5f, 0.f}), space = torch::cat({2 * from, torch::full({2, 6, 1}, 2.f)}, 2);
  same("triangulate", kvision::triangulate(from, from + shift, still, moved), space);
  same("triangulate of variables", kvision::triangulate(places, from + shift, still, moved).detach(), space);
  Tensor const sideways = torch::tensor({{0.f, 0.f, 0.f}, {0.f, 0.f, -1.f}, {0.f, 1.f, 0.f}}).expand({2, 3, 3});
  auto const chosen =
      kvision::motion_choice(sideways, eye.expand({2, 3, 3}), eye.expand({2, 3, 3}), from, from + shift);
  same("motion_choice", std::get<2>(chosen), space);
  Tensor const levels = torch::tensor({1.f, 2.f, 3.f}).expand({2, 3});
  same("eigenvectors", std::get<0>(kvision::eigenvectors(torch::diag_embed(levels.flip(1)))), levels);
  auto const triangulate = [](auto const& t) { return kvision::triangulate(t[0], t[1], t[2], t[3]); };
  check("triangulate", triangulate, {from, from + shift, still, moved}, false);
  without("minimal", kvision::minimal(places.slice(1, 0, 3), from.slice(1, 0, 3), {}, "affine"),
          eye.expand({2, 1, 3, 3}));
  Tensor const agree = kvision::consensus(eye, from[0].t(), from[0].t(), 0.1, "homography");
  if (!torch::equal(agree, torch::full({1, 2}, 6.f)) && ++failures) std::cout << "consensus: " << agree << "\n";
  auto const [leader, most] =
      kvision::leaders(torch::cat({0 * eye, eye}), torch::tensor({{0.f, 0.f}, {1.f, 1.f}}), 1, true);
  same("leaders", leader, eye);
  same("verdict", std::get<0>(kvision::verdict(leader, most, 1, "homography")), eye[0]);

  // Levels have no gradient, and a plane of one level comes back with its own.
  Tensor const planes = torch::cat({x, torch::full({2, 1, 7, 6}, 0.3f)}, 1).requires_grad_();
  auto const slope = [&](Tensor const& y) { return torch::autograd::grad({y.sum()}, {planes})[0].mean({0, 2, 3}); };
  if (!torch::equal(slope(std::get<0>(kvision::equalize(planes, true))), torch::tensor({0.f, 0.f, 1.f})) && ++failures)
    std::cout << "equalize: the gradient is not that of the flat plane alone\n";
  if (slope(kvision::equalize_clahe(planes)).any().item<bool>() && ++failures)
    std::cout << "equalize_clahe: a gradient\n";

  // A sigma as a tensor and as numbers are the same blur.
  Tensor const by_tensor = kvision::gaussian_blur2d(x, torch::tensor({{1.5f, 0.7f}}), 5, 3, 0, 0);
  if (!torch::allclose(by_tensor, kvision::gaussian_blur2d(x, {}, 5, 3, 1.5, 0.7)) && ++failures)
    std::cout << "gaussian_blur2d: sigma as a tensor differs\n";
  std::cout << checks << " derivatives, " << failures << " failures\n";
  return failures > 0;
}
