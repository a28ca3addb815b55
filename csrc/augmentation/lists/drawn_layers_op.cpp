// Layers of noise of lists of images, drawn and changed in steps by one call: schemas and entries, for CPU and CUDA.
#include "augmentation/elastic_glue.h"
#include "augmentation/lists/list_steps.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// The block of memory that layers (1, H, W) of these sizes follow each other in.
Tensor block_of(Tensors const& layers, std::vector<int64_t> const& sides) {
  int64_t const length = geometry::offsets_in_block(1, {"spatter_layers", sides, layers.size()}, layers.size()).back();
  return view_of(layers[0], {length}, {1});
}

// The packed layers (add_layer_list) of rain or mud, and the largest values (B,) of those of rain. `sides` has height
// and width of each image; windows and sigmas of both blurs are those of gaussian_blur2d, and parameters those of
// drop_depths.
std::tuple<Tensor, Tensor> spatter_layers(Tensor const& standard, Tensor const& keys, OptionalTensor const& seeds,
                                          OptionalTensor const& chosen, std::vector<int64_t> const& plan,
                                          std::vector<int64_t> const& sides, OptionalTensor const& sigma, int64_t ky,
                                          int64_t kx, double sigma_y, double sigma_x, Tensor const& parameters,
                                          bool is_rain, OptionalTensor const& soft_sigma, int64_t soft_ky,
                                          int64_t soft_kx, double soft_sigma_y, double soft_sigma_x) {
  Tensors const noise = steps::drawn_noise(standard, 1, sides, true, standard, keys, seeds, chosen, plan);
  Tensors const smoothed = steps::gaussian_blur(noise, sigma, ky, kx, sigma_y, sigma_x, Border::replicate);
  if (is_rain) {
    Tensors const depths = steps::equalize(steps::drop_depths(smoothed, parameters), true);
    Tensors const reliefs = steps::drop_reliefs(smoothed, parameters, depths);
    return {block_of(reliefs, sides), steps::brightest(reliefs)};
  }
  Tensors const stains = steps::gaussian_blur(steps::mark_stains(smoothed, parameters), soft_sigma, soft_ky, soft_kx,
                                              soft_sigma_y, soft_sigma_x, Border::replicate);
  return {block_of(stains, sides), empty({0}, standard)};
}

// Uniform noise (2, H, W) of each image around 0, by its scale in parameters (B, 2), blurred by sigmas of `sigma`
// heights and widths: maps of a list.
Tensor blurred_maps(Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                    OptionalTensor const& chosen, std::vector<int64_t> const& plan, std::vector<int64_t> const& sides,
                    double sigma, int64_t border) {
  constexpr char const* op = "blurred_maps";
  Border const checked = to_border(op, border);
  filters::SideBlur const blur{{sigma}, {sigma}};
#if defined(KV_CUDA)
  if (auto const maps = blurred_maps_of_sides(op, parameters, keys, seeds, chosen, plan, sides, blur, checked))
    return *maps;
#endif
  Tensors const noise = steps::drawn_noise(parameters, 2, sides, false, parameters, keys, seeds, chosen, plan);
  return steps::gaussian_blur_of_sides(noise, blur, checked);
}

}  // namespace

KV_OPERATOR(spatter_layers,
            "(Tensor standard, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan, int[] sides, "
            "Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, Tensor parameters, bool is_rain, "
            "Tensor? soft_sigma, int soft_ky, int soft_kx, float soft_sigma_y, float soft_sigma_x) -> (Tensor, Tensor)")
KV_OPERATOR(blurred_maps,
            "(Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan, int[] sides, float sigma, "
            "int border) -> Tensor")

}  // namespace kv::augmentation
