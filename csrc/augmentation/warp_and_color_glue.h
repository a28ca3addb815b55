// Passes over images for the entries of operators. Included by warp_and_color_op.cpp and draw_warp_and_color_op.cpp.
#pragma once

#include "glue/glue.h"

namespace kv::augmentation {

// The result, the matrices of the warp (B, 3, 3), and the means of contrast (B, 1), where there are any.
struct PassResults {
  Tensor y;
  std::optional<Tensor> matrix, means;
};

// With matrices that were computed from the columns before, or with none.
PassResults run_pass(Tensor const& image, std::optional<Tensor> const& columns, std::optional<Tensor> const& fill,
                     std::optional<Tensor> const& matrices, std::vector<int64_t> const& size,
                     std::vector<int64_t> const& plan, std::vector<double> const& numbers);

}  // namespace kv::augmentation
