// Random parameters for the entries of operators. Included by draws_op.cpp and draw_warp_and_color_op.cpp.
#pragma once

#include <algorithm>
#include <span>

#include "augmentation/draws.h"
#include "glue/glue.h"

namespace kv::augmentation {

// The draws of a plan, as make_plan in draws.py writes it, without the memory of their result.
DrawParameters<float> draws_of(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                               std::span<int64_t const> plan, std::span<double const> numbers);

// Memory for their result, (B, columns).
inline Tensor columns_for(DrawParameters<float>& p, Tensor const& images) {
  Tensor const result = empty({p.batch, p.columns}, images, Layout::planar, ScalarType::Float);
  p.result = data_ptr<float>(result);
  return result;
}

// A part of the memory of a contiguous tensor, from element `offset` on: a second tensor for less than an allocation.
inline Tensor part_of(Tensor const& x, std::initializer_list<int64_t> sizes, int64_t offset) {
  int64_t strides[8], stride = 1;
  for (size_t axis = sizes.size(); axis-- > 0;) {
    strides[axis] = stride;
    stride *= std::max(sizes.begin()[axis], int64_t(1));
  }
  AtenTensorHandle handle;
  TORCH_ERROR_CODE_CHECK(
      aoti_torch__reinterpret_tensor(x.get(), int64_t(sizes.size()), sizes.begin(), strides, offset, &handle));
  return Tensor(handle);
}

}  // namespace kv::augmentation
