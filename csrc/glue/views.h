// Views of the memory of tensors, which cost the host less than allocations. Included by *_glue.h files and *_op.cpp
// files.
#pragma once

#include "glue/glue.h"

namespace kv {

// From element `offset` of `x` on.
inline Tensor view_of(Tensor const& x, std::initializer_list<int64_t> sizes, int64_t const* strides, int64_t offset) {
  AtenTensorHandle handle;
  TORCH_ERROR_CODE_CHECK(
      aoti_torch__reinterpret_tensor(x.get(), int64_t(sizes.size()), sizes.begin(), strides, offset, &handle));
  return Tensor(handle);
}
inline Tensor view_of(Tensor const& x, std::initializer_list<int64_t> sizes, std::initializer_list<int64_t> strides) {
  return view_of(x, sizes, strides.begin(), 0);
}
// Contiguous.
inline Tensor view_of(Tensor const& x, std::initializer_list<int64_t> sizes, int64_t offset) {
  int64_t strides[8], stride = 1;
  for (size_t axis = sizes.size(); axis-- > 0;) {
    strides[axis] = stride;
    stride *= std::max(sizes.begin()[axis], int64_t(1));
  }
  return view_of(x, sizes, strides, offset);
}

// Of the type and device of `like`, in the memory of `x`, which outlives it.
inline Tensor in_memory_of(Tensor const& x, Tensor const& like, std::initializer_list<int64_t> sizes,
                           int64_t const* strides) {
  int32_t dtype, device_type;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_dtype(like.get(), &dtype));
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_device_type(like.get(), &device_type));
  AtenTensorHandle handle;
  auto const keep = [](void*, void*) {};
  TORCH_ERROR_CODE_CHECK(torch_from_blob(x.mutable_data_ptr(), int64_t(sizes.size()), sizes.begin(), strides, 0, dtype,
                                         device_type, int32_t(x.get_device_index()), &handle,
                                         aoti_torch_layout_strided(), nullptr, 0, keep, nullptr));
  return Tensor(handle);
}

}  // namespace kv
