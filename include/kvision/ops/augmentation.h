// Random parameters and the matrices that they give. Arguments are those of torch.ops.kvision, plans and numbers those
// of python/kvision/augmentation/draws.py and transforms.py.
#pragma once

#include "kvision/ops/operator.h"

namespace kvision::ops {

inline constexpr Operator<"draw_parameters",
                          Tensor(Tensor images, Tensor keys, OptionalTensor seeds, Ints plan, Floats numbers)>
    draw_parameters{non_differentiable};
inline constexpr Operator<"transform_matrix", Tensor(Tensor columns, Ints plan, Floats numbers)> transform_matrix{
    from<"transform_matrix_backward">};

}  // namespace kvision::ops
