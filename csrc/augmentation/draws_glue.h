// Random parameters for the entries of operators. Included by draws_op.cpp and draw_warp_and_color_op.cpp.
#pragma once

#include <algorithm>
#include <span>

#include "augmentation/draws.h"
#include "glue/glue.h"

namespace kv::augmentation {

// The parameters of the kernel for a plan that make_plan in draws.py has written; `result` is not set.
DrawParameters<float> draws_of(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                               std::span<int64_t const> plan, std::span<double const> numbers);

// Allocates the result (B, columns) of the draws, and sets it in `p`.
inline Tensor columns_for(DrawParameters<float>& p, Tensor const& images) {
  Tensor const result = empty({p.batch, p.columns}, images, Layout::planar, ScalarType::Float);
  p.result = data_ptr<float>(result);
  return result;
}

// A contiguous view of the memory of tensor `x` from element `offset` on. Several views of one allocation cost the host
// less than several allocations.
inline Tensor view_of(Tensor const& x, std::initializer_list<int64_t> sizes, int64_t offset) {
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
