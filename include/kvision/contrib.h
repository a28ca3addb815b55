// Regions. Each function has the arguments of the operator torch.ops.kvision.<name>, which python/kvision/contrib
// explains.
#pragma once

#include "kvision/operator.h"

namespace kvision {

// The regions of masks (B, C, H, W), corners included: where a mask is 1 the int64 label of its region, which is 1 +
// the index of its first pixel in the plane, 0 elsewhere.
inline Tensor connected_components(Tensor const& input) {
  using namespace detail;
  return call<"connected_components">(input.detach());
}

}  // namespace kvision
