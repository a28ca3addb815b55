// Losses, as python/kvision/losses has them. Labels are int64. A second derivative is an error.
#pragma once

#include "kvision/metrics.h"
#include "kvision/ops/losses.h"
#include "kvision/types.h"

namespace kvision {

// --- segmentation

namespace detail {

// Logits (B, C, H, W) and labels (B, H, W).
inline void labels(char const* op, Tensor const& pred, Tensor const& target) {
  images(op, "pred", pred);
  TORCH_CHECK_VALUE(target.dim() == 3 && target.size(0) == pred.size(0) && target.size(1) == pred.size(2) &&
                        target.size(2) == pred.size(3),
                    op, ": expected target of shape (B, H, W) for pred of ", pred.sizes(), ", got ", target.sizes());
  TORCH_CHECK_TYPE(target.scalar_type() == at::kLong, op, ": expected target of int64, got ", target.scalar_type());
}

inline Tensor overlap(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight, bool over_classes,
                      double alpha, double beta, double eps, std::optional<int64_t> ignore_index) {
  Tensor const loss = std::get<0>(ops::overlap(pred.unsqueeze(0), target.unsqueeze(0), weight, over_classes, alpha,
                                               beta, eps, ignore_index.value_or(0), ignore_index.has_value()));
  return loss[0].to(pred.scalar_type());
}
inline std::optional<Tensor> class_weights(std::optional<Tensor> const& weight, Tensor const& pred) {
  return weight ? std::optional(computed(*weight, pred).unsqueeze(0)) : std::nullopt;
}

}  // namespace detail

struct DiceLossOptions {
  TORCH_ARG(bool, micro) = true;  // over all classes, or the mean of their losses
  TORCH_ARG(double, eps) = 1e-8;
  TORCH_ARG(std::optional<Tensor>, weight);  // (C,)
  TORCH_ARG(std::optional<int64_t>, ignore_index) = -100;
};
inline Tensor dice_loss(Tensor const& pred, Tensor const& target, DiceLossOptions const& options = {}) {
  detail::labels("dice_loss", pred, target);
  return detail::overlap(pred, target, detail::class_weights(options.weight(), pred), options.micro(), 0.5, 0.5,
                         options.eps() / 2, options.ignore_index());
}
inline Tensor tversky_loss(Tensor const& pred, Tensor const& target, double alpha = 0.5, double beta = 0.5,
                           double eps = 1e-8, std::optional<int64_t> ignore_index = -100) {
  detail::labels("tversky_loss", pred, target);
  return detail::overlap(pred, target, {}, false, alpha, beta, eps, ignore_index);
}

struct FocalLossOptions {
  TORCH_ARG(std::optional<double>, alpha) = 0.5;
  TORCH_ARG(double, gamma) = 2;
  TORCH_ARG(Reduction, reduction) = Reduction::none;
  TORCH_ARG(std::optional<Tensor>, weight);  // (C,)
  TORCH_ARG(std::optional<int64_t>, ignore_index) = -100;
};
inline Tensor focal_loss(Tensor const& pred, Tensor const& target, FocalLossOptions const& options = {}) {
  detail::labels("focal_loss", pred, target);
  bool const summed = options.reduction() != Reduction::none;
  double const factor = detail::mean_factor(options.reduction(), pred.numel()), alpha = options.alpha().value_or(0);
  Tensor const loss =
      ops::focal(pred.unsqueeze(0), target.unsqueeze(0), detail::class_weights(options.weight(), pred),
                 options.alpha() ? (1 - alpha) * factor : factor, options.alpha() ? alpha * factor : factor,
                 options.gamma(), options.ignore_index().value_or(0), options.ignore_index().has_value(), summed);
  if (summed) return loss[0].to(pred.scalar_type());
  Tensor const index = target.clamp(0, pred.size(1) - 1).unsqueeze(1);
  return at::zeros_like(pred).scatter(1, index, loss[0].unsqueeze(1).to(pred.scalar_type()));
}

struct BinaryFocalLossOptions {
  TORCH_ARG(std::optional<double>, alpha) = 0.25;
  TORCH_ARG(double, gamma) = 2;
  TORCH_ARG(Reduction, reduction) = Reduction::none;
  TORCH_ARG(std::optional<Tensor>, pos_weight);  // (C,)
  TORCH_ARG(std::optional<Tensor>, weight);      // (C,)
  TORCH_ARG(std::optional<double>, ignore_index) = -100;
};
// Of logits and targets (B, C, *).
inline Tensor binary_focal_loss_with_logits(Tensor const& pred, Tensor const& target,
                                            BinaryFocalLossOptions const& options = {}) {
  detail::same_shape("binary_focal_loss_with_logits", "target", target, pred);
  bool const summed = options.reduction() != Reduction::none, weighted = options.weight() || options.pos_weight();
  double const factor = detail::mean_factor(options.reduction(), pred.numel()), alpha = options.alpha().value_or(0);
  std::optional<Tensor> yes, no;
  if (weighted) {
    Tensor const ones = at::ones({pred.size(1)}, pred.options().dtype(detail::computed_type(pred)));
    Tensor const each = detail::computed(options.weight(), pred).value_or(ones);
    auto const of_rows = [&](Tensor const& x) { return x.expand({pred.size(0), -1}).reshape({-1}); };
    no = of_rows(each);
    yes = of_rows(each * detail::computed(options.pos_weight(), pred).value_or(ones));
  }
  auto const rows = [&](Tensor const& x) { return weighted ? x.flatten(2).flatten(0, 1) : x.reshape({1, -1}); };
  Tensor const loss = ops::binary_focal(rows(pred), rows(target.to(pred.scalar_type())), yes, no,
                                        options.alpha() ? alpha * factor : factor,
                                        options.alpha() ? (1 - alpha) * factor : factor, options.gamma(),
                                        options.ignore_index().value_or(0), options.ignore_index().has_value(), summed);
  return (summed ? loss.sum() : loss.view(pred.sizes())).to(pred.scalar_type());
}

inline Tensor lovasz_softmax_loss(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight = {}) {
  detail::labels("lovasz_softmax_loss", pred, target);
  Tensor const losses = std::get<0>(ops::lovasz(pred, target, false));
  return (weight ? losses.mean(0) * *weight : losses).mean().to(pred.scalar_type());
}
// Of logits (B, 1, H, W) and labels (B, H, W), 0 or 1.
inline Tensor lovasz_hinge_loss(Tensor const& pred, Tensor const& target) {
  detail::labels("lovasz_hinge_loss", pred, target);
  return std::get<0>(ops::lovasz(pred, target, true)).mean().to(pred.scalar_type());
}

// Of probabilities (B, C, H, W) and labels (B, 1, H, W), or those of volumes.
inline Tensor hausdorff_er_loss(Tensor const& pred, Tensor const& target, double alpha = 2, int64_t k = 10,
                                Reduction reduction = Reduction::mean) {
  TORCH_CHECK_VALUE(pred.dim() >= 4 && target.dim() == pred.dim(),
                    "hausdorff_er_loss: expected target of shape (B, 1, H, W) or (B, 1, D, H, W) for pred of ",
                    pred.sizes(), ", got ", target.sizes());
  Tensor const loss =
      ops::hausdorff(detail::computed(pred, pred), target.select(1, 0), alpha, k, reduction != Reduction::none);
  if (reduction == Reduction::none) return loss.movedim(1, 0).unsqueeze(2).to(pred.scalar_type());
  return (loss.sum() * detail::mean_factor(reduction, pred.numel())).to(pred.scalar_type());
}

// --- images

inline Tensor ssim_loss(Tensor const& img1, Tensor const& img2, int64_t window_size, double max_val = 1,
                        double eps = 1e-12, Reduction reduction = Reduction::mean, Padding padding = Padding::same) {
  if (reduction == Reduction::none) return ((1 - ssim(img1, img2, window_size, max_val, eps, padding)) / 2).clamp(0, 1);
  Tensor const x = detail::floats(detail::images("ssim_loss", "img1", img1)), y = img2.to(x.scalar_type());
  detail::same_shape("ssim_loss", "img2", y, x);
  int64_t const less = padding == Padding::valid ? window_size - 1 : 0;
  int64_t const count = x.size(0) * x.size(1) * (x.size(2) - less) * (x.size(3) - less);
  Tensor const loss =
      ops::ssim_loss(x, y, window_size, 1.5, detail::ssim_constant(0.01, max_val), detail::ssim_constant(0.03, max_val),
                     eps, detail::ssim_padding(padding), 0.5 * detail::mean_factor(reduction, count), 0);
  return loss.sum().to(x.scalar_type());
}

struct MsSsimLossOptions {
  TORCH_ARG(std::vector<double>, sigmas) = { 0.5, 1, 2, 4, 8 };
  TORCH_ARG(double, data_range) = 1;
  TORCH_ARG(Pair, K) = Pair({0.01, 0.03});
  TORCH_ARG(double, alpha) = 0.025;  // the weight of the absolute differences is 1 - alpha
  TORCH_ARG(double, compensation) = 200;
  TORCH_ARG(Reduction, reduction) = Reduction::mean;
};
inline Tensor ms_ssim_loss(Tensor const& img1, Tensor const& img2, MsSsimLossOptions const& options = {}) {
  Tensor const x = detail::floats(detail::images("ms_ssim_loss", "img1", img1)), y = img2.to(x.scalar_type());
  detail::same_shape("ms_ssim_loss", "img2", y, x);
  int64_t const size = 2 * int64_t(2 * options.sigmas().back()) + 1;
  auto const constant = [&](int i) { return detail::ssim_constant(options.K()->at(i), options.data_range()); };
  Tensor const loss =
      ops::ms_ssim(x, y, options.sigmas(), size, constant(0), constant(1), options.compensation() * options.alpha(),
                   options.compensation() * (1 - options.alpha()) / options.data_range());
  return detail::reduced(loss, options.reduction()).to(x.scalar_type());
}

inline Tensor psnr_loss(Tensor const& image, Tensor const& target, double max_val = 1) {
  return detail::decibels("psnr_loss", image, target, max_val, 10);
}

inline Tensor charbonnier_loss(Tensor const& img1, Tensor const& img2, Reduction reduction = Reduction::none) {
  return detail::pointwise("charbonnier_loss", detail::charbonnier, img1, img2, reduction);
}
inline Tensor welsch_loss(Tensor const& img1, Tensor const& img2, Reduction reduction = Reduction::none) {
  return detail::pointwise("welsch_loss", detail::welsch, img1, img2, reduction);
}
inline Tensor cauchy_loss(Tensor const& img1, Tensor const& img2, Reduction reduction = Reduction::none) {
  return detail::pointwise("cauchy_loss", detail::cauchy, img1, img2, reduction);
}
inline Tensor geman_mcclure_loss(Tensor const& img1, Tensor const& img2, Reduction reduction = Reduction::none) {
  return detail::pointwise("geman_mcclure_loss", detail::geman_mcclure, img1, img2, reduction);
}

namespace detail {

inline Tensor divergence(char const* op, PointLoss kind, Tensor const& pred, Tensor const& target,
                         Reduction reduction) {
  same_shape(op, "target", target, images(op, "pred", pred));
  auto const rows = [&](Tensor const& x) { return x.to(pred.scalar_type()).flatten(2).flatten(0, 1); };
  Tensor const sums = ops::pointwise_sum(rows(pred), rows(target), kind, 1, 0);
  return reduced(sums.view(pred.sizes().slice(0, 2)), reduction).to(pred.scalar_type());
}

}  // namespace detail

// Of maps (B, C, H, W), each of which adds up to 1.
inline Tensor kl_div_loss_2d(Tensor const& pred, Tensor const& target, Reduction reduction = Reduction::mean) {
  return detail::divergence("kl_div_loss_2d", detail::kl, pred, target, reduction);
}
inline Tensor js_div_loss_2d(Tensor const& pred, Tensor const& target, Reduction reduction = Reduction::mean) {
  return detail::divergence("js_div_loss_2d", detail::js, pred, target, reduction);
}

// (B, C): the absolute differences of adjacent pixels, summed or for `mean` averaged along each axis.
inline Tensor total_variation(Tensor const& img, Reduction reduction = Reduction::sum) {
  Tensor const x = detail::floats(detail::images("total_variation", "img", img));
  int64_t const h = x.size(2), w = x.size(3);
  return ops::total_variation(x, detail::mean_factor(reduction, std::max<int64_t>(1, (h - 1) * w)),
                              detail::mean_factor(reduction, std::max<int64_t>(1, h * (w - 1))))
      .to(x.scalar_type());
}

// Of inverse depth (B, 1, H, W) and images (B, C, H, W).
inline Tensor inverse_depth_smoothness_loss(Tensor const& idepth, Tensor const& image) {
  detail::images("inverse_depth_smoothness_loss", "idepth", idepth);
  detail::images("inverse_depth_smoothness_loss", "image", image);
  int64_t const b = idepth.size(0), h = idepth.size(2), w = idepth.size(3);
  return ops::smoothness(idepth, image, 1.0 / std::max<int64_t>(1, b * (h - 1) * w),
                         1.0 / std::max<int64_t>(1, b * h * (w - 1)))
      .sum()
      .to(idepth.scalar_type());
}

enum class MIKernel { xu, rectangular, truncated_gaussian };

struct MutualInformationOptions {
  TORCH_ARG(std::optional<Tensor>, input_mask);  // (N,) or (H, W): which samples count
  TORCH_ARG(std::optional<Tensor>, target_mask);
  TORCH_ARG(MIKernel, kernel_function) = MIKernel::xu;
  TORCH_ARG(int64_t, num_bins) = 64;
  TORCH_ARG(double, window_radius) = 1;
};

namespace detail {

inline Tensor mutual_information(char const* op, int64_t axes, Tensor const& input, Tensor const& target,
                                 MutualInformationOptions const& options, bool normalized) {
  same_shape(op, "target", target, input);
  TORCH_CHECK_VALUE(input.dim() >= axes, op, ": expected input of at least ", axes, " axes, got ", input.sizes());
  auto const rows = [&](Tensor const& x) {
    Tensor const flat = computed(x, x).flatten(-axes);
    return flat.reshape({-1, flat.size(-1)});
  };
  auto const mask = [](std::optional<Tensor> const& x) {
    return x ? std::optional(x->to(at::kBool).reshape({1, -1})) : std::nullopt;
  };
  int64_t const kernel = int64_t(options.kernel_function());
  Tensor const loss = std::get<0>(ops::mutual_information(rows(input), rows(target), mask(options.input_mask()),
                                                          mask(options.target_mask()), kernel, options.num_bins(),
                                                          options.window_radius(), normalized));
  return loss.reshape(input.sizes().slice(0, input.dim() - axes)).to(target.scalar_type());
}

}  // namespace detail

// The negative mutual information of signals (*, N), or with _2d of images (*, H, W).
inline Tensor mutual_information_loss(Tensor const& input, Tensor const& target,
                                      MutualInformationOptions const& options = {}) {
  return detail::mutual_information("mutual_information_loss", 1, input, target, options, false);
}
inline Tensor mutual_information_loss_2d(Tensor const& input, Tensor const& target,
                                         MutualInformationOptions const& options = {}) {
  return detail::mutual_information("mutual_information_loss_2d", 2, input, target, options, false);
}
inline Tensor normalized_mutual_information_loss(Tensor const& input, Tensor const& target,
                                                 MutualInformationOptions const& options = {}) {
  return detail::mutual_information("normalized_mutual_information_loss", 1, input, target, options, true);
}
inline Tensor normalized_mutual_information_loss_2d(Tensor const& input, Tensor const& target,
                                                    MutualInformationOptions const& options = {}) {
  return detail::mutual_information("normalized_mutual_information_loss_2d", 2, input, target, options, true);
}

}  // namespace kvision
