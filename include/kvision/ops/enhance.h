// Statistics of whole images, blends and codecs. Arguments are those of torch.ops.kvision.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/ops/operator.h"

namespace kvision::ops {

// Levels have no gradient; planes that come back as they are, of one level or NaN, have their own.
namespace detail {

inline constexpr Rule unchanged_planes{
    [](Backward const& b) { return b.call("equalize_backward", {{"grad", b.grad()}}, unchanged_planes); }, 0, false};

}  // namespace detail

inline constexpr Operator<"equalize", Two(Tensor input, bool opencv)> equalize{
    [](Backward const& b) { return b.call("equalize_backward", {}, detail::unchanged_planes); }, 2, false};
inline constexpr Operator<"equalize_clahe", Tensor(Tensor input, OptionalTensor clip_limits, double clip_limit,
                                                   int64_t rows, int64_t columns, bool opencv)>
    equalize_clahe{[](Backward const& b) -> variable_list {
                     return b.call("equalize_backward", {{"output", b.results[0]}, {"changed", {}}},
                                   detail::unchanged_planes);
                   },
                   1, false};

inline constexpr Operator<"normalize_min_max", Two(Tensor input, double low, double high, double eps)>
    normalize_min_max{from<"normalize_min_max_backward", 1>};
inline constexpr Operator<"histogram", Tensor(Tensor x, Tensor centers, Tensor bandwidth)> histogram{
    from<"histogram_backward">};
inline constexpr Operator<"image_histogram2d", Tensor(Tensor x, double low, double width, int64_t bins, int64_t kernel)>
    image_histogram2d{from<"image_histogram2d_backward">};

// alpha input + beta other + gamma, by weights (B, C, 1) or by the numbers a, b and c instead.
inline constexpr Operator<"add_weighted", Tensor(Tensor input, Tensor other, OptionalTensor alpha, OptionalTensor beta,
                                                 OptionalTensor gamma, double a, double b, double c)>
    add_weighted{[](Backward const& b) -> variable_list {
      Tensor const &g = b.grad(), x = b.tensor(0), y = b.tensor(1);
      auto const scaled = [&](size_t weights, size_t number) {
        Tensor const w = b.tensor(weights);
        return w.defined() ? (g * w.unsqueeze(3)).to(g.scalar_type()) : g * b.arguments[number].toDouble();
      };
      auto const summed = [&](size_t i, auto const& pixels) { return b.needs(i) ? pixels().sum(3) : Tensor(); };
      return {scaled(2, 5), scaled(3, 6), summed(2, [&] { return g * x; }), summed(3, [&] { return g * y; }),
              summed(4, [&] { return g; })};
    }};
inline constexpr Operator<"sharpness", Tensor(Tensor input, OptionalTensor factor, double number)> sharpness{
    [](Backward const& b) -> variable_list {
      return b.call("sharpness_backward", {{"of_image", b.needs(0)}, {"of_factor", b.needs(1)}});
    }};
inline constexpr Operator<"jpeg", Tensor(Tensor input, OptionalTensor quality, OptionalTensor table_y,
                                         OptionalTensor table_c, double number)>
    jpeg{[](Backward const& b) -> variable_list {
      bool const of_steps = b.needs(1) || b.needs(2) || b.needs(3);
      variable_list gradients = b.call("jpeg_backward", {{"of_image", b.needs(0)}, {"of_steps", of_steps}});
      gradients[1] = gradients[1].flatten();
      return gradients;
    }};

}  // namespace kvision::ops
