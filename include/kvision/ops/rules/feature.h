// Gradients of matching that are no single call.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops::detail::rules {

// From the distances of the first set's neighbors; those of the second set are constants.
inline constexpr Rule two_nearest{
    [](Backward const& b) {
      Tensor const none = at::zeros_like(b.results[1]);
      return b.call("two_nearest_backward",
                    {{"grad1", b.grad()}, {"grad2", none}, {"indices1", b.results[0]}, {"indices2", b.results[2]}});
    },
    3};

}  // namespace kvision::ops::detail::rules
