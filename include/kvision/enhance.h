// Statistics of whole images (B, C, H, W), blends and codecs, as python/kvision/enhance has them. A second derivative
// is an error.
#pragma once

#include "kvision/ops/enhance.h"
#include "kvision/types.h"

namespace kvision {

namespace detail {

// A number for each sample (B,) or channel (B, C) as (B or 1, C or 1, 1).
inline std::optional<Tensor> factors(Parameter const& x, Tensor const& image) {
  if (!x.tensor) return {};
  Tensor const t = computed(*x.tensor, image);
  return t.dim() == 2 ? t.unsqueeze(2) : t.reshape({-1, 1, 1});
}

}  // namespace detail

inline Tensor equalize(Tensor const& input, bool opencv = false) {
  return std::get<0>(ops::equalize(detail::images("equalize", "input", input), opencv));
}
// clip_limit: a number, or a tensor (B or 1,) or (B or 1, C or 1).
inline Tensor equalize_clahe(Tensor const& input, Parameter const& clip_limit = 40, Size2d grid_size = 8,
                             bool opencv = false) {
  Tensor const x = detail::images("equalize_clahe", "input", input);
  return ops::equalize_clahe(x, detail::factors(clip_limit, x), clip_limit.number, grid_size->at(0), grid_size->at(1),
                             opencv);
}

inline Tensor normalize_min_max(Tensor const& input, double min_val = 0, double max_val = 1, double eps = 1e-6) {
  Tensor const x = detail::floats(detail::images("normalize_min_max", "input", input));
  return std::get<0>(ops::normalize_min_max(x, min_val, max_val, eps, false, false));
}

// The densities (B, K) of values (B, D) at points (K,), by Gaussians of a bandwidth; the gradient is to the values.
inline Tensor histogram(Tensor const& x, Tensor const& bins, Parameter const& bandwidth, double epsilon = 1e-10) {
  Tensor const values = detail::computed(detail::shaped("histogram", "x", x, 2, "(B, D)"), x);
  Tensor const width = bandwidth.tensor ? *bandwidth.tensor : at::full({1}, bandwidth.number, values.options());
  Tensor const counts =
      ops::histogram(values, detail::computed(bins, x).unsqueeze(0), detail::computed(width, x).reshape({1}));
  // epsilon goes with counts divided by D.
  return ops::normalize_counts(counts, epsilon * double(x.size(1))).to(detail::floats(x).scalar_type());
}

// The counts of every plane (B, C, n_bins) in bins from `min` to `max`. kernel: "triangular", "epanechnikov" or
// "uniform".
inline Tensor image_histogram2d(Tensor const& image, double min = 0, double max = 255, int64_t n_bins = 256,
                                std::string const& kernel = "triangular") {
  Tensor const x =
      detail::computed(detail::images("image_histogram2d", "image", image), image).flatten(2).flatten(0, 1);
  int64_t const number =
      detail::index_of("image_histogram2d", "kernel", kernel, {"triangular", "epanechnikov", "uniform"});
  return ops::image_histogram2d(x, min, (max - min) / n_bins, n_bins, number)
      .view({image.size(0), image.size(1), n_bins});
}

// src1 alpha + src2 beta + gamma, by numbers or tensors (B or 1,) or (B or 1, C or 1).
inline Tensor add_weighted(Tensor const& src1, Parameter const& alpha, Tensor const& src2, Parameter const& beta,
                           Parameter const& gamma) {
  Tensor const x = detail::floats(detail::images("add_weighted", "src1", src1)), y = detail::floats(src2);
  detail::same_shape("add_weighted", "src2", y, x);
  return ops::add_weighted(x, y, detail::factors(alpha, x), detail::factors(beta, x), detail::factors(gamma, x),
                           alpha.number, beta.number, gamma.number);
}

inline Tensor sharpness(Tensor const& input, Parameter const& factor) {
  Tensor const x = detail::images("sharpness", "input", input);
  return ops::sharpness(x, detail::factors(factor, x), factor.number);
}

// jpeg_quality: from 0 to 100, a number or a tensor (B or 1,); tables (B or 1, 8, 8), or those of the standard.
inline Tensor jpeg_codec_differentiable(Tensor const& input, Parameter const& jpeg_quality,
                                        std::optional<Tensor> const& quantization_table_y = {},
                                        std::optional<Tensor> const& quantization_table_c = {}) {
  Tensor const x = detail::colors("jpeg_codec_differentiable", "input", input);
  return ops::jpeg(x, detail::computed(jpeg_quality.tensor, x), detail::computed(quantization_table_y, x),
                   detail::computed(quantization_table_c, x), jpeg_quality.number);
}

}  // namespace kvision
