// Peaks and depth. Each function has the arguments of the operator torch.ops.kvision.<name>, which
// python/kvision/geometry/subpix and python/kvision/geometry/depth explain, and gradients. Images are (B, C, H, W),
// volumes (B, C, D, H, W). Depth (B or 1, 1, h, w), cameras (B or 1, 3, 3) and projections (B or 1, 3, 4) are in
// float32, for float64 images in float64. Second derivatives are errors, but for those of local maxima.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "kvision/geometry.h"
#include "kvision/operator.h"

namespace kvision {

// --- peaks -----------------------------------------------------------------------------------------------------------

// Images where `flags` (uint8) are not 0, and 0 elsewhere.
inline Tensor keep_marked(Tensor const& input, Tensor const& flags) {
  return detail::linear<"keep_marked">(input, [=](Tensor const& grad) { return keep_marked(grad, flags); }, flags);
}

// What is above all others of its window (z, y, x), 0 elsewhere, and where that is: 0 and 1, uint8, empty unless it is
// to be `marked` or there is a gradient. With `volumes` the channels are planes of a volume.
inline std::tuple<Tensor, Tensor> local_maxima(Tensor const& input, std::vector<int64_t> const& window,
                                               bool volumes = false, bool marked = false) {
  using namespace detail;
  bool const differentiated = at::GradMode::is_enabled() && input.requires_grad();
  auto const [values, maxima] =
      call<"local_maxima", std::tuple<Tensor, Tensor>>(input.detach(), window, volumes, marked || differentiated);
  auto const compute = [&] { return variable_list{values}; };
  auto const gradient = [](Backward const& b) { return variable_list{keep_marked(b.grads[0], b.saved[0])}; };
  return {differentiable({input}, compute, {maxima}, gradient)[0], maxima};
}

// Where these are: 0 and 1, uint8.
inline Tensor is_local_maximum(Tensor const& input, std::vector<int64_t> const& window, bool volumes = false) {
  return detail::call<"is_local_maximum">(input.detach(), window, volumes);
}

// Where maxima, and where minima are.
inline std::tuple<Tensor, Tensor> local_extrema(Tensor const& input, std::vector<int64_t> const& window,
                                                bool volumes = false) {
  return detail::call<"local_extrema", std::tuple<Tensor, Tensor>>(input.detach(), window, volumes);
}

inline Tensor mean_place_backward(Tensor const& grad, Tensor const& places, Tensor const& parts, Tensor const& input,
                                  bool softmax, double scale, bool normalized) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"mean_place_backward">(grad, places, parts, input, softmax, scale, normalized)};
  };
  return differentiable({grad, places, input}, compute, {}, no_second_derivative("mean_place"))[0];
}

// The mean places (B, C, 2) of the pixels of images (B, C, H, W), x before y, weighted by their values or the softmax
// of `scale` times these; and without a gradient (B, C, 2) what that is made of: the largest value, and the sum of
// exponentials over it.
inline std::tuple<Tensor, Tensor> mean_place(Tensor const& input, bool softmax = true, double scale = 1,
                                             bool normalized = true) {
  using namespace detail;
  auto const compute = [&] {
    auto [places, parts] = call<"mean_place", std::tuple<Tensor, Tensor>>(input, softmax, scale, normalized);
    return variable_list{places, parts};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const x = b.saved[0];
    auto const [places, parts] = mean_place(x.detach(), softmax, scale, normalized);
    return variable_list{mean_place_backward(b.grads[0], places, parts, x, softmax, scale, normalized)};
  };
  variable_list const found = differentiable({input}, compute, {input}, gradient);
  return {found[0], found[1].detach()};
}

inline std::tuple<Tensor, Tensor> gaussian_maps_backward(Tensor const& grad, Tensor const& mean, Tensor const& std,
                                                         bool normalized) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_mean, to_std] = call<"gaussian_maps_backward", std::tuple<Tensor, Tensor>>(grad, mean, std, normalized);
    return variable_list{to_mean, to_std};
  };
  variable_list const found = differentiable({grad, mean, std}, compute, {}, no_second_derivative("gaussian_maps"));
  return {found[0], found[1]};
}

// Heat maps (P, height, width) of Gaussians, each of which adds up to 1, of means and standard deviations (P, 2), x
// before y, in pixels or from -1 to 1; one of either serves all.
inline Tensor gaussian_maps(Tensor const& mean, Tensor const& std, int64_t height, int64_t width,
                            bool normalized = true) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"gaussian_maps">(mean, std, height, width, normalized)}; };
  auto const gradient = [normalized](Backward const& b) {
    Tensor const &m = b.saved[0], &s = b.saved[1];
    auto const [to_mean, to_std] = gaussian_maps_backward(b.grads[0], m, s, normalized);
    return variable_list{to_mean.sum_to_size(m.sizes()), to_std.sum_to_size(s.sizes())};
  };
  return differentiable({mean, std}, compute, {mean, std}, gradient)[0];
}

inline Tensor soft_argmax_backward(Tensor const& grad_places, Tensor const& grad_values, Tensor const& input,
                                   std::vector<int64_t> const& window, std::vector<int64_t> const& stride,
                                   std::vector<int64_t> const& padding, double temperature, bool normalized,
                                   bool scale_too, bool with_values) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"soft_argmax_backward">(grad_places, grad_values, input, window, stride, padding,
                                                      temperature, normalized, scale_too, with_values)};
  };
  return differentiable({grad_places, grad_values, input}, compute, {}, no_second_derivative("soft_argmax"))[0];
}

// Of every window of volumes, sizes being (z, y, x): its mean place under the softmax of its values, (x, y) or with
// `scale_too` (z, x, y), and the mean of these, empty unless `with_values`.
inline std::tuple<Tensor, Tensor> soft_argmax(Tensor const& input, std::vector<int64_t> const& window,
                                              std::vector<int64_t> const& stride, std::vector<int64_t> const& padding,
                                              double temperature = 1, bool normalized = false, bool scale_too = true,
                                              bool with_values = true) {
  using namespace detail;
  auto const compute = [&] {
    auto [places, values] = call<"soft_argmax", std::tuple<Tensor, Tensor>>(input, window, stride, padding, temperature,
                                                                            normalized, scale_too, with_values);
    return variable_list{places, values};
  };
  auto const gradient = [=](Backward const& b) {
    return variable_list{soft_argmax_backward(b.grads[0], b.grads[1], b.saved[0], window, stride, padding, temperature,
                                              normalized, scale_too, with_values)};
  };
  variable_list const found = differentiable({input}, compute, {input}, gradient);
  return {found[0], found[1]};
}

inline Tensor quadratic_peaks_backward(Tensor const& grad_places, Tensor const& grad_values, Tensor const& input,
                                       std::optional<Tensor> const& chosen, int64_t steps, double largest_shift,
                                       int64_t radius, bool along_scale) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"quadratic_peaks_backward">(grad_places, grad_values, input, chosen, steps, largest_shift,
                                                          radius, along_scale)};
  };
  return differentiable({grad_places, grad_values, input}, compute, {}, no_second_derivative("quadratic_peaks"))[0];
}

// Places (z, x, y) of the maxima of volumes, or of voxels that are `chosen` (uint8), between voxels, and values there.
inline std::tuple<Tensor, Tensor> quadratic_peaks(Tensor const& input, std::optional<Tensor> const& chosen = {},
                                                  int64_t steps = 5, double largest_shift = 0.6, int64_t radius = 1,
                                                  bool along_scale = true) {
  using namespace detail;
  auto const compute = [&] {
    auto [places, values] =
        call<"quadratic_peaks", std::tuple<Tensor, Tensor>>(input, chosen, steps, largest_shift, radius, along_scale);
    return variable_list{places, values};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const &x = b.saved[0], &which = b.saved[1];
    std::optional<Tensor> const given = which.defined() ? std::optional(which) : std::nullopt;
    return variable_list{
        quadratic_peaks_backward(b.grads[0], b.grads[1], x, given, steps, largest_shift, radius, along_scale)
            .to(x.scalar_type())};
  };
  variable_list const found = differentiable({input}, compute, {input, chosen.value_or(Tensor())}, gradient);
  return {found[0], found[1]};
}

// --- depth -----------------------------------------------------------------------------------------------------------

// From the gradient to points (B, 3, H, W) of depth (B, 1, H, W) to each camera (B, 3, 3).
inline Tensor depth_camera(Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"depth_camera">(grad, depth, camera, distance)}; };
  return differentiable({grad, depth, camera}, compute, {}, no_second_derivative("depth_points"))[0];
}

inline Tensor depth_points_backward(Tensor const& grad, Tensor const& camera, bool distance) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"depth_points_backward">(grad, camera, distance)}; };
  return differentiable({grad, camera}, compute, {}, no_second_derivative("depth_points"))[0];
}

// The points (B, 3, H, W) that depth images show, with `last` (B, H, W, 3); its gradient is to depth. With `distance`
// depth is no z.
inline Tensor depth_points(Tensor const& depth, Tensor const& camera, bool distance = false, bool last = false) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"depth_points">(depth, camera, distance, last)}; };
  auto const gradient = [=](Backward const& b) {
    Tensor const grad = last ? b.grads[0].movedim(-1, 1) : b.grads[0];
    return variable_list{depth_points_backward(grad, b.saved[0], distance)};
  };
  return differentiable({depth}, compute, {camera}, gradient)[0];
}

// To the points (B, 3, H, W) that normals are those of.
inline Tensor depth_normals_to_points(Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"depth_normals_to_points">(grad, depth, camera, distance)}; };
  return differentiable({grad, depth, camera}, compute, {}, no_second_derivative("depth_normals"))[0];
}

inline Tensor depth_normals_backward(Tensor const& grad, Tensor const& depth, Tensor const& camera, bool distance) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"depth_normals_backward">(grad, depth, camera, distance)}; };
  return differentiable({grad, depth, camera}, compute, {}, no_second_derivative("depth_normals"))[0];
}

// Unit normals; the gradient to the camera is Python's.
inline Tensor depth_normals(Tensor const& depth, Tensor const& camera, bool distance = false) {
  using namespace detail;
  auto const compute = [&] { return variable_list{call<"depth_normals">(depth, camera, distance)}; };
  auto const gradient = [=](Backward const& b) {
    return variable_list{depth_normals_backward(b.grads[0], b.saved[0], b.saved[1], distance)};
  };
  return differentiable({depth}, compute, {depth, camera}, gradient)[0];
}

// For each sample, also where one of the four serves all.
inline std::tuple<Tensor, Tensor, Tensor, Tensor> reprojection_backward(Tensor const& grad, Tensor const& camera_to,
                                                                        Tensor const& pose_to,
                                                                        Tensor const& camera_from,
                                                                        std::optional<Tensor> const& pose_from,
                                                                        bool pinhole) {
  using namespace detail;
  auto const compute = [&] {
    auto [a, b, c, d] = call<"reprojection_backward", std::tuple<Tensor, Tensor, Tensor, Tensor>>(
        grad, camera_to, pose_to, camera_from, pose_from, pinhole);
    return variable_list{a, b, c, d};
  };
  variable_list const found = differentiable({grad, camera_to, pose_to, camera_from, pose_from.value_or(Tensor())},
                                             compute, {}, no_second_derivative("reprojection"));
  return {found[0], found[1], found[2], found[3]};
}

// From pixels of a camera (B, 3, 3) at a depth to those of another, as depth_warp takes it; their poses (B, 4, 4) are
// rigid, from the world. One of each serves a batch. pinhole: of the cameras only focal lengths and principal points
// are used.
inline Tensor reprojection(Tensor const& camera_to, Tensor const& pose_to, Tensor const& camera_from,
                           std::optional<Tensor> const& pose_from = {}, bool pinhole = false) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"reprojection">(camera_to, pose_to, camera_from, pose_from, pinhole)};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const& last = b.saved[3];
    auto const [to_camera_to, to_pose_to, to_camera_from, to_pose_from] = reprojection_backward(
        b.grads[0], b.saved[0], b.saved[1], b.saved[2], last.defined() ? std::optional(last) : std::nullopt, pinhole);
    return variable_list{summed_to(to_camera_to, b.saved[0]), summed_to(to_pose_to, b.saved[1]),
                         summed_to(to_camera_from, b.saved[2]),
                         last.defined() ? summed_to(to_pose_from, last) : Tensor()};
  };
  variable_list const given{camera_to, pose_to, camera_from, pose_from.value_or(Tensor())};
  return differentiable(given, compute, given, gradient)[0];
}

inline Tensor depth_warp_image_gradient(Tensor const& grad, Tensor const& depth, Tensor const& projection,
                                        std::vector<int64_t> const& size, std::string const& interpolation,
                                        std::string const& padding, bool align_corners) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{
        call<"depth_warp_image_gradient">(grad, depth, projection, size, interpolation, padding, align_corners)};
  };
  return differentiable({grad, depth, projection}, compute, {}, no_second_derivative("depth_warp"))[0];
}

// For each sample, also where one depth or projection serves all.
inline std::tuple<Tensor, Tensor> depth_warp_slopes(Tensor const& grad, Tensor const& image, Tensor const& depth,
                                                    Tensor const& projection, std::string const& interpolation,
                                                    std::string const& padding, bool align_corners) {
  using namespace detail;
  auto const compute = [&] {
    auto [to_depth, to_projection] = call<"depth_warp_slopes", std::tuple<Tensor, Tensor>>(
        grad, image, depth, projection, interpolation, padding, align_corners);
    return variable_list{to_depth, to_projection};
  };
  variable_list const found =
      differentiable({grad, image, depth, projection}, compute, {}, no_second_derivative("depth_warp"));
  return {found[0], found[1]};
}

// What an image shows where the pixels of depth images are seen in it: (u, v, 1) ~ d A (x, y, 1) + b, projection
// [A | b].
inline Tensor depth_warp(Tensor const& image, Tensor const& depth, Tensor const& projection,
                         std::string const& interpolation = "bilinear", std::string const& padding = "fill",
                         bool align_corners = true) {
  using namespace detail;
  auto const compute = [&] {
    return variable_list{call<"depth_warp">(image, depth, projection, interpolation, padding, align_corners)};
  };
  auto const gradient = [=](Backward const& b) {
    Tensor const &grad = b.grads[0], &x = b.saved[0], &d = b.saved[1], &p = b.saved[2];
    variable_list found(3);
    if (b.wanted(0))
      found[0] = depth_warp_image_gradient(computed(grad), d, p, image_size(x), interpolation, padding, align_corners)
                     .to(grad.scalar_type());
    if (b.wanted(1) || b.wanted(2)) {
      auto const [to_depth, to_projection] = depth_warp_slopes(grad, x, d, p, interpolation, padding, align_corners);
      found[1] = summed_to(to_depth, d);
      found[2] = summed_to(to_projection, p);
    }
    return found;
  };
  return differentiable({image, depth, projection}, compute, {image, depth, projection}, gradient)[0];
}

// The mean distance (B) of targets from views (B, V, C, H, W) warped by depth and projections (B or 1, V, 3, 4), which
// it has gradients to. distance: "l1", "l2" or "charbonnier".
inline Tensor photometric_depth(Tensor const& views, Tensor const& target, Tensor const& depth,
                                Tensor const& projections, std::string const& distance = "l1", double eps = 1e-3) {
  using namespace detail;
  auto const [loss, to_depth, share, to_projections] = [&] {
    at::NoGradGuard no_grad;
    return call<"photometric_depth", std::tuple<Tensor, Tensor, Tensor, Tensor>>(views, target, depth.detach(),
                                                                                 projections.detach(), distance, eps);
  }();
  auto const compute = [&] { return variable_list{loss}; };
  auto const gradient = [](Backward const& b) {
    Tensor const &grad = b.grads[0], &slopes = b.saved[0], &each = b.saved[1], &turns = b.saved[2];
    Tensor const &d = b.saved[3], &p = b.saved[4];
    auto const found = [&] {
      return variable_list{summed_to((grad * each).view({-1, 1, 1, 1}) * slopes, d),
                           summed_to(grad.view({-1, 1, 1, 1}) * turns, p)};
    };
    return differentiable({grad, d, p}, found, {}, no_second_derivative("photometric_depth"));
  };
  return differentiable({depth, projections}, compute, {to_depth, share, to_projections, depth, projections},
                        gradient)[0];
}

}  // namespace kvision
