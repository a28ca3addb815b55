// Warps by depth: schemas and entries, for CPU and CUDA.
#include "geometry/depth/warp_glue.h"

namespace kv::geometry {
namespace {

SamplingOptions options_of(char const* op, int64_t interpolation, int64_t padding, bool align_corners,
                           Tensor const& x) {
  SamplingOptions const options(op, interpolation, padding, align_corners, x, {});
  KV_CHECK(options.interpolation != Interpolation::bicubic, op, ": interpolation must be 0 (nearest) or 3 (bilinear)");
  return options;
}

Tensor depth_warp(Tensor const& image, Tensor const& depth, Tensor const& projection, int64_t interpolation,
                  int64_t padding, bool align_corners) {
  char const* const op = "depth_warp";
  check_images(op, "image", image);
  Size const source = checked_size(op, image);
  SamplingOptions const options = options_of(op, interpolation, padding, align_corners, image);
  KV_CHECK(projection.dim() == 3, op, ": expected projection of 3 axes, got ", projection.dim());
  Depths const depths(op, depth, projection, image);
  Size const output = depths.size();
  int64_t const batch = image.size(0), channels = image.size(1);
  Tensor const y = empty({batch, channels, output.height, output.width}, image, layout_of(image));
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    DepthWarp<T> params{};
    depths.set(params, options, source, batch);
    params.x = images<T const>(image, batch);
    params.y = images<T>(y, batch);
    check_planes(op, params.x);
    KV_RUN(depth_warp, image, params, y.numel() > 0 ? batch * output.height : 0, 8 * channels * output.width);
  });
  return y;
}

Tensor depth_warp_image_backward(Tensor const& grad, Tensor const& depth, Tensor const& projection,
                                 std::vector<int64_t> size, int64_t interpolation, int64_t padding,
                                 bool align_corners) {
  char const* const op = "depth_warp_image_backward";
  check_images(op, "grad", grad);
  Size const source = checked_size(op, size);
  SamplingOptions const options = options_of(op, interpolation, padding, align_corners, grad);
  KV_CHECK(projection.dim() == 3, op, ": expected projection of 3 axes, got ", projection.dim());
  Depths const depths(op, depth, projection, grad);
  Size const output = depths.size();
  KV_CHECK(grad.size(2) == output.height && grad.size(3) == output.width, op, ": grad does not fit the depth");
  int64_t const batch = grad.size(0), channels = grad.size(1);
  Tensor const grad_x = empty({batch, channels, source.height, source.width}, grad);
  dispatch_compute_dtype(op, grad, [&](auto type) {
    using F = typename decltype(type)::type;
    DepthWarpImageBackward<F> params{};
    depths.set(params, options, source, batch);
    params.grad = images<F const>(grad, batch);
    params.grad_x = images<F>(grad_x, batch);
    KV_RUN(depth_warp_image_backward, grad, params, batch * channels, 16 * output.height * output.width);
  });
  return grad_x;
}

// Gradients of every sample, also if all share one depth or projection.
std::tuple<Tensor, Tensor> depth_warp_coords_backward(Tensor const& grad, Tensor const& image, Tensor const& depth,
                                                      Tensor const& projection, int64_t interpolation, int64_t padding,
                                                      bool align_corners) {
  char const* const op = "depth_warp_coords_backward";
  check_images(op, "image", image);
  check_images(op, "grad", grad);
  Size const source = checked_size(op, image);
  SamplingOptions const options = options_of(op, interpolation, padding, align_corners, image);
  KV_CHECK(projection.dim() == 3, op, ": expected projection of 3 axes, got ", projection.dim());
  Depths const depths(op, depth, projection, grad);
  Size const output = depths.size();
  int64_t const batch = grad.size(0), parts = projection_parts(output);
  KV_CHECK((image.size(0) == 1 || image.size(0) == batch) && grad.size(1) == image.size(1) &&
               grad.scalar_type() == image.scalar_type() && grad.device() == image.device() &&
               grad.size(2) == output.height && grad.size(3) == output.width,
           op, ": grad does not fit the image or the depth");
  Tensor const grad_depth = empty({batch, 1, output.height, output.width}, depths.depth);
  Tensor const grad_projection = empty({batch, 3, 4}, depths.projection);
  Tensor const sums = empty({batch, parts, kProjectionSums}, grad, Layout::planar, ScalarType::Double);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    DepthWarpCoordsBackward<T> params{};
    depths.set(params, options, source, batch);
    params.x = images<T const>(image, batch);
    params.grad = images<T const>(grad, batch);
    params.grad_depth = data_ptr<F>(grad_depth);
    params.sums = data_ptr<double>(sums);
    params.parts = parts;
    KV_RUN(depth_warp_coords_backward, image, params, batch * output.height, 16 * image.size(1) * output.width);
    ProjectionTotal<F> const total{data_ptr<double const>(sums), parts,   batch,  1, int(image.size(1)),
                                   data_ptr<F>(grad_projection), nullptr, nullptr};
    KV_RUN(projection_total, image, total, batch, 12 * parts);
  });
  return {grad_depth, grad_projection};
}

}  // namespace

#define KV_SAMPLING_OPTIONS "int interpolation, int padding, bool align_corners"

KV_OPERATOR(depth_warp, "(Tensor image, Tensor depth, Tensor projection, " KV_SAMPLING_OPTIONS ") -> Tensor")
KV_OPERATOR(depth_warp_image_backward,
            "(Tensor grad, Tensor depth, Tensor projection, int[] size, " KV_SAMPLING_OPTIONS ") -> Tensor")
KV_OPERATOR(depth_warp_coords_backward,
            "(Tensor grad, Tensor image, Tensor depth, Tensor projection, " KV_SAMPLING_OPTIONS ") -> (Tensor, Tensor)")

#undef KV_SAMPLING_OPTIONS

}  // namespace kv::geometry
