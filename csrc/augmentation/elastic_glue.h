// Displacements of elastic transforms for the entries of operators.
#pragma once

#include "augmentation/elastic.h"
#include "augmentation/noise_glue.h"
#include "core/border.h"

namespace kv::augmentation {

// The window of the blur, its standard deviations, and the scales of x and y.
struct ElasticBlur {
  int64_t ky, kx;
  double sigma_y, sigma_x, scale[2];
};

// Writes the displacements `result` (B, 2, H, W), which is dense: of `noise`, or of noise of `source` if there is one,
// whose images are the result; then those of samples that are not `chosen`, (B,) float32, are 0.
void write_displacements(char const* op, Tensor const* noise, NoiseSource const* source, ElasticBlur const& blur,
                         Tensor const& result, std::optional<Tensor> const& chosen = {});

#if defined(KV_CUDA)
// Maps of a list of uniform noise, by its scale in parameters (B, 2), drawn and blurred in one launch; nothing where no
// kernel serves them.
std::optional<Tensor> blurred_maps_of_sides(char const* op, Tensor const& parameters, Tensor const& keys,
                                            std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                                            std::vector<int64_t> const& plan, std::vector<int64_t> const& sides,
                                            filters::SideBlur const& blur, Border border);
#endif

}  // namespace kv::augmentation
