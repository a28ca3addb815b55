// Total variation of image planes: the weighted sum of the absolute differences of neighbors along y and along x, one
// number per plane, and its gradient, a sum of signs.
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "sign.h"

namespace kv::losses {

template <class T>
struct TotalVariation {
  Planes<T const> x;
  Compute<T> along_y, along_x;  // weights
  Compute<T>* sums;
  int64_t chunks;       // CUDA: strips of a plane
  Compute<T>* partial;  // CUDA: the sums of all chunks
};

template <class T>
struct TotalVariationBackward {
  Planes<T const> x;
  Compute<T> along_y, along_x;
  Compute<T> const* grad;
  Planes<T> grad_x;
};

// CUDA: the part of a plane per warp.
constexpr int kVariationRows = 16;
template <class T>
constexpr int kVariationColumns = 32 * (sizeof(T) == 2 ? 8 : 4);

KV_KERNEL(total_variation, TotalVariation)
KV_KERNEL(total_variation_backward, TotalVariationBackward)

}  // namespace kv::losses
