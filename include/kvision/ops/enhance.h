// Statistics of whole images, blends and codecs. Arguments are those of torch.ops.kvision. Written by
// tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/enhance.h"

namespace kvision::ops {

namespace detail {

inline variable_list channel_contrast_gradients(Backward const& b);
inline variable_list equalize_clahe_gradients(Backward const& b);
inline variable_list equalize_backward_gradients(Backward const& b);
inline variable_list equalize_gradients(Backward const& b);
inline variable_list histogram_gradients(Backward const& b);
inline variable_list normalize_counts_gradients(Backward const& b);
inline variable_list image_histogram2d_gradients(Backward const& b);
inline variable_list normalize_min_max_gradients(Backward const& b);
inline variable_list sharpness_gradients(Backward const& b);

}  // namespace detail

// --- enhance/add_weighted_op.cpp

// alpha input + beta other + gamma, by weights (B, C, 1) or by the numbers a, b and c instead.
inline constexpr Operator<"add_weighted", Tensor(Tensor input, Tensor other, OptionalTensor alpha, OptionalTensor beta,
                                                 OptionalTensor gamma, double a, double b, double c)>
    add_weighted{detail::rules::add_weighted};

// --- enhance/channels/channel_contrast_op.cpp

inline constexpr Operator<"channel_contrast", Tensor(Tensor input, double factor)> channel_contrast{
    Rule{detail::channel_contrast_gradients}};

// --- enhance/clahe_op.cpp

inline constexpr Operator<"equalize_clahe", Tensor(Tensor input, OptionalTensor clip_limits, double clip_limit,
                                                   int64_t rows, int64_t columns, bool opencv)>
    equalize_clahe{Rule{detail::equalize_clahe_gradients, 1, false}};

// --- enhance/equalize_op.cpp

inline constexpr Operator<"equalize", Two(Tensor input, bool opencv)> equalize{
    Rule{detail::equalize_gradients, 2, false}};

// --- enhance/histogram_op.cpp

inline constexpr Operator<"histogram", Tensor(Tensor x, Tensor centers, Tensor bandwidth)> histogram{
    Rule{detail::histogram_gradients}};
inline constexpr Operator<"normalize_counts", Tensor(Tensor counts, double eps)> normalize_counts{
    Rule{detail::normalize_counts_gradients}};

// --- enhance/image_histogram2d_op.cpp

inline constexpr Operator<"image_histogram2d", Tensor(Tensor x, double low, double width, int64_t bins, int64_t kernel)>
    image_histogram2d{Rule{detail::image_histogram2d_gradients}};

// --- enhance/jpeg_op.cpp

inline constexpr Operator<"jpeg", Tensor(Tensor input, OptionalTensor quality, OptionalTensor table_y,
                                         OptionalTensor table_c, double number)>
    jpeg{detail::rules::jpeg};

// --- enhance/min_max_op.cpp

inline constexpr Operator<"normalize_min_max",
                          Two(Tensor input, double low, double high, double eps, bool clamps, bool keeps_flat)>
    normalize_min_max{Rule{detail::normalize_min_max_gradients, 1}};

// --- enhance/sharpness_op.cpp

inline constexpr Operator<"sharpness", Tensor(Tensor input, OptionalTensor factor, double number)> sharpness{
    Rule{detail::sharpness_gradients}};

// --- rules

namespace detail {

inline variable_list channel_contrast_gradients(Backward const& b) {
  return b.run("channel_contrast_backward", {b.grads[0], b.arguments[0], b.arguments[1]}, no_gradient);
}

inline variable_list equalize_clahe_gradients(Backward const& b) {
  return b.run("equalize_backward", {b.grads[0], b.results[0], c10::IValue()},
               Rule{equalize_backward_gradients, 0, false});
}

inline variable_list equalize_backward_gradients(Backward const& b) {
  return b.run("equalize_backward", {b.grads[0], b.arguments[1], b.arguments[2]},
               Rule{equalize_backward_gradients, 0, false});
}

inline variable_list equalize_gradients(Backward const& b) {
  return b.run("equalize_backward", {b.grads[0], b.results[0], b.results[1]},
               Rule{equalize_backward_gradients, 0, false});
}

inline variable_list histogram_gradients(Backward const& b) {
  return b.run("histogram_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list normalize_counts_gradients(Backward const& b) {
  return b.run("normalize_counts_backward", {b.grads[0], b.arguments[0], b.arguments[1]}, no_gradient);
}

inline variable_list image_histogram2d_gradients(Backward const& b) {
  return b.run("image_histogram2d_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4]},
               no_gradient);
}

inline variable_list normalize_min_max_gradients(Backward const& b) {
  return b.run("normalize_min_max_backward",
               {b.grads[0], b.arguments[0], b.results[0], b.arguments[1], b.arguments[2], b.arguments[3],
                b.arguments[4], b.arguments[5]},
               no_gradient);
}

inline variable_list sharpness_gradients(Backward const& b) {
  return b.run("sharpness_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.needs(0), b.needs(1)}, no_gradient);
}

}  // namespace detail

}  // namespace kvision::ops
