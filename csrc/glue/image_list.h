// Lists of tensors as the tables that kernels take. Included by the *_op.cpp files of operators of lists.
#pragma once

#include "core/image_list.h"
#include "glue/images.h"
#include "glue/views.h"

namespace kv {

using Tensors = std::vector<Tensor>;

// An image (C, H, W) as a batch of one.
inline Tensor as_batch(Tensor const& x) {
  return view_of(x, {1, x.size(0), x.size(1), x.size(2)}, {x.numel(), x.stride(0), x.stride(1), x.stride(2)});
}

// Raises unless these are images (C, H, W) with pixels, of one type, device and number of channels.
inline void check_image_list(char const* op, char const* name, Tensors const& images) {
  KV_CHECK(!images.empty(), op, ": expected ", name, " with at least one image");
  Tensor const& first = images[0];
  for (Tensor const& x : images)
    KV_CHECK(x.dim() == 3 && x.size(0) == first.size(0) && x.scalar_type() == first.scalar_type() &&
                 x.device() == first.device() && x.size(1) > 0 && x.size(2) > 0 && x.size(1) <= INT32_MAX &&
                 x.size(2) <= INT32_MAX,
             op, ": expected ", name, " of shape (C, H, W), with pixels, of one type, device and number of channels");
}

inline ListedImage listed(Tensor const& x) {
  return {x.const_data_ptr(), x.stride(0), x.stride(1), x.stride(2), int(x.size(1)), int(x.size(2))};
}

}  // namespace kv
