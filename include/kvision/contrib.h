// Regions and patches. Each function has the arguments of the operator torch.ops.kvision.<name>, which
// python/kvision/contrib explains.
#pragma once

#include <vector>

#include "kvision/operator.h"

namespace kvision {

// The regions of masks (B, C, H, W), corners included: where a mask is 1 the int64 label of its region, which is 1 +
// the index of its first pixel in the plane, 0 elsewhere.
inline Tensor connected_components(Tensor const& input) {
  using namespace detail;
  return call<"connected_components">(input.detach());
}

inline Tensor combine_patches(Tensor const&, std::vector<int64_t> const&, std::vector<int64_t> const&,
                              std::vector<int64_t> const&, std::vector<int64_t> const&);

// (B, N, C, *window): the windows of images (B, C, *size), row by row, with zeros for padding (top, bottom, left,
// right).
inline Tensor extract_patches(Tensor const& input, std::vector<int64_t> const& size, std::vector<int64_t> const& window,
                              std::vector<int64_t> const& stride, std::vector<int64_t> const& padding) {
  auto const transpose = [=](Tensor const& grad) { return combine_patches(grad, size, window, stride, padding); };
  return detail::linear<"extract_patches">(input, transpose, size, window, stride, padding);
}

// (B, C, *size): the patches added up where they belong.
inline Tensor combine_patches(Tensor const& patches, std::vector<int64_t> const& size,
                              std::vector<int64_t> const& window, std::vector<int64_t> const& stride,
                              std::vector<int64_t> const& padding) {
  auto const transpose = [=](Tensor const& grad) { return extract_patches(grad, size, window, stride, padding); };
  return detail::linear<"combine_patches">(patches, transpose, size, window, stride, padding);
}

}  // namespace kvision
