// Layers of noise of lists of images, drawn and changed in steps by one call: schemas and entries, for CPU and CUDA.
#include "augmentation/lists/list_steps.h"
#include "geometry/transform/lists/warp_list_glue.h"

namespace kv::augmentation {
namespace {

// Layers (1, H, W) as one tensor (B, 1, H, W) of the largest sides, 0 beyond each. `identity` is a matrix (1, 3, 3).
Tensor layers_as_batch(Tensors const& layers, Tensor const& identity) {
  constexpr char const* op = "spatter_layers";
  int64_t const batch = int64_t(layers.size());
  std::vector<int64_t> sides{0, 0};
  for (Tensor const& x : layers)
    for (int64_t axis : {0, 1}) sides[size_t(axis)] = std::max(sides[size_t(axis)], x.size(1 + axis));
  Tensor const like = as_batch(layers[0]);
  geometry::SamplingOptions const a(op, geometry::Interpolation::nearest, geometry::Padding::fill, true, like, {},
                                    {op, {}, batch, batch, like});
  geometry::Matrix const m(op, identity, like, batch, false, false, true, {1, 1}, {1, 1});
  return geometry::warped_list(layers, a, m, sides)[0];
}

// The layers (B, 1, H, W) of rain or mud, and the largest values (B,) of those of rain. `sides` has height and width of
// each image; windows and sigmas of both blurs are those of gaussian_blur2d, and parameters those of drop_depths.
std::tuple<Tensor, Tensor> spatter_layers(Tensor const& identity, Tensor const& standard, Tensor const& keys,
                                          OptionalTensor const& seeds, OptionalTensor const& chosen,
                                          std::vector<int64_t> const& plan, std::vector<int64_t> const& sides,
                                          OptionalTensor const& sigma, int64_t ky, int64_t kx, double sigma_y,
                                          double sigma_x, Tensor const& parameters, bool is_rain,
                                          OptionalTensor const& soft_sigma, int64_t soft_ky, int64_t soft_kx,
                                          double soft_sigma_y, double soft_sigma_x) {
  Tensors const noise = steps::drawn_noise(identity, 1, sides, true, standard, keys, seeds, chosen, plan);
  Tensors const smoothed = steps::gaussian_blur(noise, sigma, ky, kx, sigma_y, sigma_x, Border::replicate);
  if (is_rain) {
    Tensors const depths = steps::equalize(steps::drop_depths(smoothed, parameters), true);
    Tensors const reliefs = steps::drop_reliefs(smoothed, parameters, depths);
    return {layers_as_batch(reliefs, identity), steps::brightest(reliefs)};
  }
  Tensors const stains = steps::gaussian_blur(steps::mark_stains(smoothed, parameters), soft_sigma, soft_ky, soft_kx,
                                              soft_sigma_y, soft_sigma_x, Border::replicate);
  return {layers_as_batch(stains, identity), empty({0}, identity)};
}

// Uniform noise (2, H, W) of each image around 0, by its scale in parameters (B, 2), blurred by sigmas of `sigma`
// heights and widths: maps of a list.
Tensor blurred_maps(Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                    OptionalTensor const& chosen, std::vector<int64_t> const& plan, std::vector<int64_t> const& sides,
                    double sigma, int64_t border) {
  Tensors const noise = steps::drawn_noise(parameters, 2, sides, false, parameters, keys, seeds, chosen, plan);
  return steps::gaussian_blur_of_sides(noise, sigma, to_border("blurred_maps", border));
}

}  // namespace

KV_OPERATOR(spatter_layers,
            "(Tensor identity, Tensor standard, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan, int[] sides, "
            "Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, Tensor parameters, bool is_rain, "
            "Tensor? soft_sigma, int soft_ky, int soft_kx, float soft_sigma_y, float soft_sigma_x) -> (Tensor, Tensor)")
KV_OPERATOR(blurred_maps,
            "(Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan, int[] sides, float sigma, "
            "int border) -> Tensor")

}  // namespace kv::augmentation
