// Metrics, as python/kvision/metrics has them. A second derivative is an error.
#pragma once

#include "kvision/ops/metrics.h"
#include "kvision/types.h"

namespace kvision {

namespace detail {

inline double ssim_constant(double k, double max_val) { return k * max_val * k * max_val; }
// The numbers of the operators: 0 reflects, 2 leaves out windows that pass the border.
inline int64_t ssim_padding(Padding padding) { return padding == Padding::valid ? 2 : 0; }
// The numbers of pointwise losses.
enum PointLoss : int64_t { charbonnier, welsch, cauchy, geman_mcclure, square, kl, js };

// Losses of elements: a map, or `factor` times their sum, or that many decibels of it.
inline Tensor pointwise(char const* op, PointLoss kind, Tensor const& x, Tensor const& y, Reduction reduction) {
  same_shape(op, "img2", y, x);
  Tensor const a = x.reshape({1, -1}), b = y.to(x.scalar_type()).reshape({1, -1});
  if (reduction == Reduction::none) return ops::pointwise_loss(a, b, kind).view(x.sizes());
  return ops::pointwise_sum(a, b, kind, mean_factor(reduction, x.numel()), 0)[0].to(x.scalar_type());
}
inline Tensor decibels(char const* op, Tensor const& image, Tensor const& target, double max_val, double decibels) {
  same_shape(op, "target", target, image);
  Tensor const x = floats(image), y = target.to(x.scalar_type());
  double const factor = 1 / (x.numel() * max_val * max_val);
  return ops::pointwise_sum(x.reshape({1, -1}), y.reshape({1, -1}), square, factor, decibels)[0].to(x.scalar_type());
}

}  // namespace detail

// The structural similarity of images of one shape, in Gaussian windows.
inline Tensor ssim(Tensor const& img1, Tensor const& img2, int64_t window_size, double max_val = 1, double eps = 1e-12,
                   Padding padding = Padding::same) {
  Tensor const x = detail::floats(detail::images("ssim", "img1", img1)), y = img2.to(x.scalar_type());
  detail::same_shape("ssim", "img2", y, x);
  return ops::ssim(x, y, window_size, 1.5, detail::ssim_constant(0.01, max_val), detail::ssim_constant(0.03, max_val),
                   eps, detail::ssim_padding(padding), true);
}

inline Tensor psnr(Tensor const& image, Tensor const& target, double max_val) {
  return detail::decibels("psnr", image, target, max_val, -10);
}

// The mean distance of vectors (*, 2).
inline Tensor aepe(Tensor const& input, Tensor const& target, Reduction reduction = Reduction::mean) {
  TORCH_CHECK_VALUE(input.dim() > 0 && input.size(-1) == 2, "aepe: expected input of shape (*, 2), got ",
                    input.sizes());
  detail::same_shape("aepe", "target", target, input);
  Tensor const x = detail::floats(input), y = target.to(x.scalar_type());
  Tensor const errors =
      ops::endpoint_error(x.reshape({1, -1, 2}), y.reshape({1, -1, 2}), false, reduction != Reduction::none,
                          detail::mean_factor(reduction, x.numel() / 2));
  return reduction == Reduction::none ? errors.view(x.sizes().slice(0, x.dim() - 1)) : errors[0].to(x.scalar_type());
}

namespace detail {

inline Tensor confusion(char const* op, Tensor const& pred, Tensor const& target, int64_t num_classes,
                        int64_t statistic, double eps) {
  same_shape(op, "target", target, pred);
  return ops::confusion_matrix(pred.flatten(1).to(at::kLong), target.flatten(1).to(at::kLong), num_classes, statistic,
                               eps);
}

}  // namespace detail

// (B, num_classes, num_classes) of labels (B, *): a row for each class of the target.
inline Tensor confusion_matrix(Tensor const& pred, Tensor const& target, int64_t num_classes, bool normalized = false) {
  return detail::confusion("confusion_matrix", pred, target, num_classes, normalized ? 1 : 0, 1e-6);
}
// (B, num_classes): the intersection over union of every class.
inline Tensor mean_iou(Tensor const& pred, Tensor const& target, int64_t num_classes, double eps = 1e-6) {
  return detail::confusion("mean_iou", pred, target, num_classes, 2, eps);
}
// (N, M) of boxes (N, 4) and (M, 4). box_format: "xyxy", "xywh" or "cxcywh".
inline Tensor mean_iou_bbox(Tensor const& boxes_1, Tensor const& boxes_2, std::string const& box_format = "xyxy") {
  Tensor const x = detail::floats(detail::shaped("mean_iou_bbox", "boxes_1", boxes_1, 2, "(N, 4)"));
  detail::shaped("mean_iou_bbox", "boxes_2", boxes_2, 2, "(M, 4)");
  int64_t const format = detail::index_of("mean_iou_bbox", "box_format", box_format, {"xyxy", "xywh", "cxcywh"});
  return ops::box_iou(x.unsqueeze(0), boxes_2.to(x.scalar_type()).unsqueeze(0), format)[0];
}

}  // namespace kvision
