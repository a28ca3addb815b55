// Steps of operators on lists: what the operators of these names do, with results that are views of one block of
// memory. They do not leave an operator.
#pragma once

#include "core/border.h"
#include "glue/image_list.h"

namespace kv::geometry {
struct KeptSizes;
}
namespace kv::filters {
struct SideBlur;
}

namespace kv::augmentation {

using OptionalTensor = std::optional<Tensor>;

namespace steps {

// Float32 noise (channels, H, W) for height and width of each; the rest as gaussian_noise and uniform_noise have it.
Tensors drawn_noise(Tensor const& like, int64_t channels, std::vector<int64_t> const& sides, bool normal,
                    Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                    OptionalTensor const& chosen, std::vector<int64_t> const& plan);
// Fills the results of a list with uniform noise; the rest as uniform_noise has it.
void fill_with_noise(geometry::KeptSizes const& kept, Tensor const& parameters, Tensor const& keys,
                     OptionalTensor const& seeds, std::vector<int64_t> const& plan);
Tensors gaussian_blur(Tensors const& images, OptionalTensor const& sigma, int64_t ky, int64_t kx, double sigma_y,
                      double sigma_x, Border border);
// The block with the results.
Tensor gaussian_blur_of_sides(Tensors const& images, filters::SideBlur const& blur, Border border);
Tensors equalize(Tensors const& images, bool opencv);
Tensors drop_depths(Tensors const& layers, Tensor const& parameters);
Tensors drop_reliefs(Tensors const& layers, Tensor const& parameters, Tensors const& depths);
Tensors mark_stains(Tensors const& layers, Tensor const& parameters);
Tensor brightest(Tensors const& images);

}  // namespace steps
}  // namespace kv::augmentation
