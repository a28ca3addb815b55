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
  // Numbers as the interface has them: to make types and devices of them takes twice as long as all else.
  auto const number_of = [](Tensor const& x, auto get) {
    int32_t number;
    TORCH_ERROR_CODE_CHECK(get(x.get(), &number));
    return number;
  };
  int32_t const type = number_of(first, aoti_torch_get_dtype), kind = number_of(first, aoti_torch_get_device_type),
                device = first.get_device_index();
  int64_t const channels = first.dim() > 0 ? first.size(0) : 0;
  for (Tensor const& x : images) {
    auto const sizes = x.sizes();
    KV_CHECK(sizes.size() == 3 && sizes[0] == channels && number_of(x, aoti_torch_get_dtype) == type &&
                 number_of(x, aoti_torch_get_device_type) == kind && x.get_device_index() == device && sizes[1] > 0 &&
                 sizes[2] > 0 && sizes[1] <= INT32_MAX && sizes[2] <= INT32_MAX,
             op, ": expected ", name, " of shape (C, H, W), with pixels, of one type, device and number of channels");
  }
}

// The images of a list, and the gradients behind them.
inline std::pair<Tensors, Tensors> halves(char const* op, Tensors const& images_and_grads) {
  KV_CHECK(images_and_grads.size() % 2 == 0 && !images_and_grads.empty(), op, ": expected a gradient of each image");
  auto const middle = images_and_grads.begin() + int64_t(images_and_grads.size() / 2);
  return {Tensors(images_and_grads.begin(), middle), Tensors(middle, images_and_grads.end())};
}

inline ListedImage listed(Tensor const& x) {
  auto const sizes = x.sizes(), strides = x.strides();
  return {x.const_data_ptr(), strides[0], strides[1], strides[2], int(sizes[1]), int(sizes[2])};
}

}  // namespace kv
