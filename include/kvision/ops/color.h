// Color programs, mosaics and chroma. Arguments are those of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/color.h"

namespace kvision::ops {

namespace detail {

inline variable_list planes_to_rgb_gradients(Backward const& b);
inline variable_list raw_to_rgb_gradients(Backward const& b);
inline variable_list raw_to_rgb_backward_gradients(Backward const& b);

}  // namespace detail

// --- color/colormap_op.cpp

inline constexpr Operator<"apply_colormap", Tensor(Tensor input, Tensor white, Tensor colors)> apply_colormap{
    detail::rules::apply_colormap};

// --- color/frames/frames_coded_op.cpp

inline constexpr Operator<"coded_frames", Tensor(Tensor input, Ints plan, Floats numbers)> coded_frames{no_gradient};

// --- color/frames/frames_op.cpp

inline constexpr Operator<"planes_to_rgb",
                          Tensor(Tensor y, Tensor u, Tensor v, OptionalTensor map, Ints plan, Floats numbers)>
    planes_to_rgb{Rule{detail::planes_to_rgb_gradients, 1}};

// --- color/program_of_numbers_op.cpp

inline constexpr Operator<"color_program_of_numbers", Tensor(Tensor input, Tensor plan, Floats numbers)>
    color_program_of_numbers{no_gradient};

// --- color/program_op.cpp

inline constexpr Operator<"color_program", Tensor(Tensor input, OptionalTensor p0, OptionalTensor p1, OptionalTensor p2,
                                                  OptionalTensor p3, OptionalTensor p4, OptionalTensor p5,
                                                  OptionalTensor order, Ints plan, Floats numbers)>
    color_program{detail::rules::color_program};
inline constexpr Operator<"color_program_around_mean",
                          Two(Tensor input, OptionalTensor p0, OptionalTensor p1, OptionalTensor p2, OptionalTensor p3,
                              OptionalTensor p4, OptionalTensor p5, OptionalTensor order, Ints plan, Floats numbers)>
    color_program_around_mean{detail::rules::color_program_around_mean};

// --- color/raw_op.cpp

inline constexpr Operator<"raw_to_rgb", Tensor(Tensor input, int64_t cfa)> raw_to_rgb{
    Rule{detail::raw_to_rgb_gradients, 0, false}};

// --- color/yuv_op.cpp

inline constexpr Operator<"split_chroma", Two(Tensor input, int64_t rows, Floats matrix)> split_chroma{
    detail::rules::split_chroma};
inline constexpr Operator<"join_chroma", Tensor(Tensor luma, Tensor chroma, int64_t rows, Floats matrix)> join_chroma{
    detail::rules::join_chroma};

// --- rules

namespace detail {

inline variable_list planes_to_rgb_gradients(Backward const& b) {
  return b.run("planes_to_rgb_backward",
               {b.grads[0], b.results[0].detach(), b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3],
                b.arguments[4], b.arguments[5]},
               no_gradient);
}

inline variable_list raw_to_rgb_gradients(Backward const& b) {
  return b.run("raw_to_rgb_backward", {b.grads[0], b.arguments[1]}, Rule{raw_to_rgb_backward_gradients, 0, false});
}

inline variable_list raw_to_rgb_backward_gradients(Backward const& b) {
  return b.run("raw_to_rgb", {b.grads[0], b.arguments[1]}, Rule{raw_to_rgb_gradients, 0, false});
}

}  // namespace detail

}  // namespace kvision::ops
