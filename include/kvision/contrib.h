// Regions and patches of images (B, C, H, W), as python/kvision/contrib has them.
#pragma once

#include "kvision/ops/contrib.h"
#include "kvision/types.h"

namespace kvision {

// The int64 labels of regions where a mask is 1: 1 + the index of the region's first pixel in the plane; 0 elsewhere.
inline Tensor connected_components_union_find(Tensor const& image) {
  return ops::connected_components(detail::images("connected_components_union_find", "image", image));
}

// (B, N, C, *window_size): the crops of an image, row by row, that is padded by zeros (y, x).
inline Tensor extract_tensor_patches(Tensor const& input, Size2d window_size, Size2d stride = 1, Size2d padding = 0) {
  auto const [py, px] = *padding;
  return ops::extract_patches(detail::images("extract_tensor_patches", "input", input), detail::image_size(input),
                              detail::list(window_size), detail::list(stride), {py, py, px, px});
}

// (B, C, *original_size): the means of the patches that cover a pixel.
inline Tensor combine_tensor_patches(Tensor const& patches, Size2d original_size, Size2d window_size, Size2d stride,
                                     Size2d unpadding = 0) {
  detail::shaped("combine_tensor_patches", "patches", patches, 5, "(B, N, C, height, width)");
  auto const [py, px] = *unpadding;
  auto const combined = [&, py = py, px = px](Tensor const& x) {
    return ops::combine_patches(x, detail::list(original_size), detail::list(window_size), detail::list(stride),
                                {py, py, px, px});
  };
  if (*stride == *window_size) return combined(patches);
  Tensor const x = detail::computed(patches, patches), ones = at::ones_like(x.narrow(0, 0, 1).narrow(2, 0, 1));
  return (combined(x) / combined(ones).clamp_min(1)).to(patches.scalar_type());
}

}  // namespace kvision
