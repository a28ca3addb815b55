// The deterministic half of augmentation: what was drawn stands in a matrix and in the parameters of color steps.
#pragma once

#include "kvision/color.h"
#include "kvision/geometry/transform.h"
#include "kvision/ops/augmentation.h"

namespace kvision {

// Warps images by matrices M (B or 1, 3, 3), from their pixels to those of the result, as warp_perspective does, and
// applies a color program to the result, in one pass; gradients go to the image, the matrices and the parameters of the
// program, whose tensors are (B or 1, 1, P) here. uint8 images give the numbers in [0, 1] that they stand for in
// another dtype.
inline Tensor warp_and_color(Tensor const& image, Tensor const& M, Size2d dsize, ColorProgram const& program,
                             WarpOptions const& options = {}) {
  constexpr char const* op = "warp_and_color";
  detail::images(op, "image", image);
  int64_t const batch = image.size(0), steps = int64_t(program.steps.size());
  TORCH_CHECK_VALUE(M.dim() == 3 && M.size(1) == 3 && M.size(2) == 3, op, ": expected M of shape (B or 1, 3, 3), got ",
                    M.sizes());
  // The columns of the operator: the matrix by rows, the parameters of the steps, and the steps in their order.
  std::vector<Tensor> columns{detail::computed(M, image).reshape({-1, 9})};
  for (Tensor const& p : program.parameters) {
    TORCH_CHECK_VALUE(p.dim() == 3 && p.size(1) == 1, op, ": expected parameters of shape (B or 1, 1, P), got ",
                      p.sizes());
    columns.push_back(detail::computed(p, image).squeeze(1));
  }
  int64_t first = 0;
  for (Tensor const& c : columns) first += c.size(1);
  if (program.order) {
    TORCH_CHECK_VALUE(program.order->dim() == 2 && program.order->size(1) == steps, op,
                      ": expected order of shape (B or 1, ", steps, "), got ", program.order->sizes());
    columns.push_back(program.order->to(columns[0].options()));
  }
  for (Tensor& c : columns) {
    TORCH_CHECK_VALUE(c.size(0) == 1 || c.size(0) == batch, op, ": expected M, parameters and order of ", batch,
                      " images or of one, got ", c.size(0));
    c = c.expand({batch, -1});
  }
  auto fill = detail::computed(options.fill_value(), image);
  if (fill && fill->dim() < 2) fill = fill->reshape({1, -1});
  ops::Ints plan = detail::program_head(program);
  constexpr int64_t antialias = 0;
  plan.insert(plan.end(), {int64_t(options.mode()), detail::padding_number(options.padding_mode()),
                           int64_t(options.align_corners()), antialias});
  plan.insert(plan.end(), {10, int64_t(ops::TransformKind::matrix), 0, 1, 2, 3, 4, 5, 6, 7, 8, steps});
  plan.insert(plan.end(), program.steps.begin(), program.steps.end());
  plan.push_back(int64_t(program.columns.size()));
  for (int64_t column : program.columns) plan.push_back(column < 0 ? -1 : column + 9);
  for (int64_t i = 0; program.order && i < steps; ++i) plan.insert(plan.end(), {first + i, 0});
  ops::Floats numbers(9, 0.);
  numbers.insert(numbers.end(), program.numbers.begin(), program.numbers.end());
  return std::get<0>(ops::warp_and_color(image, at::cat(columns, 1), fill, detail::list(dsize), plan, numbers));
}

}  // namespace kvision
