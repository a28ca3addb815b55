// Local features, as python/kvision/feature has them. Frames (LAFs) are (B, N, 2, 3). A second derivative is an error.
#pragma once

#include "kvision/geometry/transform.h"
#include "kvision/ops/feature.h"
#include "kvision/types.h"

namespace kvision {

namespace detail {

inline Tensor frames(char const* op, char const* name, Tensor const& laf) {
  TORCH_CHECK_VALUE(laf.dim() == 4 && laf.size(2) == 2 && laf.size(3) == 3, op, ": expected ", name,
                    " of shape (B, N, 2, 3), got ", laf.sizes());
  return floats(laf);
}
// A number of each frame, as one axis of the frames' type.
inline Tensor of_frames(char const* op, char const* name, Tensor const& x, Tensor const& laf) {
  TORCH_CHECK_VALUE(x.numel() == laf.size(0) * laf.size(1), op, ": expected ", name, " with a number for each of ",
                    laf.size(0) * laf.size(1), " frames, got ", x.sizes());
  return x.reshape({-1}).to(laf.scalar_type());
}
inline Tensor rows_of_frames(Tensor const& laf) { return laf.reshape({-1, 2, 3}); }

inline void descriptors(char const* op, Tensor const& desc1, Tensor const& desc2) {
  TORCH_CHECK_VALUE(desc1.dim() == 2 && desc2.dim() == 2 && desc1.size(1) == desc2.size(1), op,
                    ": expected descriptors (N, D) and (M, D), got ", desc1.sizes(), " and ", desc2.sizes());
}

}  // namespace detail

inline Tensor get_laf_center(Tensor const& laf) { return detail::frames("get_laf_center", "LAF", laf).select(-1, 2); }
inline Tensor get_laf_scale(Tensor const& laf) {
  Tensor const x = detail::frames("get_laf_scale", "LAF", laf);
  return ops::laf_scale(detail::rows_of_frames(x)).view({x.size(0), x.size(1), 1, 1});
}
// Frames of centers (B, N, 2), scales (B, N, 1, 1) and degrees (B, N, 1).
inline Tensor laf_from_center_scale_ori(Tensor const& xy, std::optional<Tensor> const& scale = {},
                                        std::optional<Tensor> const& ori = {}) {
  char const* op = "laf_from_center_scale_ori";
  detail::shaped(op, "xy", xy, 3, "(B, N, 2)");
  Tensor const x = detail::floats(xy);
  auto part = [&](char const* name, std::optional<Tensor> const& y) {
    return y ? std::optional(detail::of_frames(op, name, *y, x)) : y;
  };
  return ops::laf_from_parts(x.reshape({-1, 2}), part("scale", scale), part("ori", ori))
      .view({x.size(0), x.size(1), 2, 3});
}
inline Tensor rotate_laf(Tensor const& laf, Tensor const& angles_degrees) {
  Tensor const x = detail::frames("rotate_laf", "LAF", laf);
  Tensor const degrees = detail::of_frames("rotate_laf", "angles_degrees", angles_degrees, x);
  return ops::rotate_laf(detail::rows_of_frames(x), degrees).view(x.sizes());
}
inline Tensor set_laf_orientation(Tensor const& laf, Tensor const& angles_degrees) {
  Tensor const x = detail::frames("set_laf_orientation", "LAF", laf);
  Tensor const degrees = detail::of_frames("set_laf_orientation", "angles_degrees", angles_degrees, x);
  return ops::set_laf_orientation(detail::rows_of_frames(x), degrees).view(x.sizes());
}
inline Tensor scale_laf(Tensor const& laf, double scale_coef) {
  Tensor const x = detail::frames("scale_laf", "laf", laf);
  return ops::scale_laf_parts(detail::rows_of_frames(x), scale_coef, 1, 1).view(x.sizes());
}
inline Tensor make_upright(Tensor const& laf, double eps = 1e-9) {
  Tensor const x = detail::frames("make_upright", "laf", laf);
  return ops::make_upright(detail::rows_of_frames(x), eps).view(x.sizes());
}
// Frames of ellipses (B, N, 5): x, y, a, b, c.
inline Tensor ellipse_to_laf(Tensor const& ells) {
  detail::shaped("ellipse_to_laf", "ells", ells, 3, "(B, N, 5)");
  return ops::ellipse_to_laf(detail::floats(ells).reshape({-1, 5})).view({ells.size(0), ells.size(1), 2, 3});
}
inline Tensor perspective_transform_lafs(Tensor const& trans_01, Tensor const& lafs_1) {
  Tensor const x = detail::frames("perspective_transform_lafs", "lafs_1", lafs_1);
  TORCH_CHECK_VALUE(
      trans_01.dim() == 3 && trans_01.size(0) == x.size(0) && trans_01.size(1) == 3 && trans_01.size(2) == 3,
      "perspective_transform_lafs: expected trans_01 of shape (B, 3, 3), got ", trans_01.sizes());
  Tensor const each = trans_01.to(x.scalar_type()).unsqueeze(1).expand({x.size(0), x.size(1), 3, 3});
  return ops::perspective_transform_laf(each.reshape({-1, 3, 3}), detail::rows_of_frames(x)).view(x.sizes());
}

// --- responses of corners and blobs (B, C, H, W), times the fourth powers of sigmas (B,)

namespace detail {

inline ops::OptionalTensor sigmas_of(char const* op, ops::OptionalTensor const& sigmas, Tensor const& x) {
  if (!sigmas) return {};
  TORCH_CHECK_VALUE(sigmas->dim() == 1 && sigmas->size(0) == x.size(0), op, ": expected sigmas of shape (", x.size(0),
                    ",), got ", sigmas->sizes());
  return computed(*sigmas, x);
}
inline Tensor corners(char const* op, Tensor const& input, double k, int64_t kind, DerivativeMode mode,
                      ops::OptionalTensor const& sigmas) {
  Tensor const x = floats(images(op, "input", input));
  TORCH_CHECK_VALUE(x.size(2) > 3 && x.size(3) > 3, op, ": expected images of at least 4 pixels along each side, got ",
                    x.sizes());
  return ops::corner_response(x, {}, sigmas_of(op, sigmas, x), k, kind, int64_t(mode));
}

}  // namespace detail

inline Tensor harris_response(Tensor const& input, double k = 0.04, DerivativeMode grads_mode = DerivativeMode::sobel,
                              std::optional<Tensor> const& sigmas = {}) {
  return detail::corners("harris_response", input, k, 0, grads_mode, sigmas);
}
inline Tensor gftt_response(Tensor const& input, DerivativeMode grads_mode = DerivativeMode::sobel,
                            std::optional<Tensor> const& sigmas = {}) {
  return detail::corners("gftt_response", input, 0, 1, grads_mode, sigmas);
}
inline Tensor hessian_response(Tensor const& input, DerivativeMode grads_mode = DerivativeMode::sobel,
                               std::optional<Tensor> const& sigmas = {}) {
  Tensor const x = detail::floats(detail::images("hessian_response", "input", input));
  return ops::hessian_response(x, detail::sigmas_of("hessian_response", sigmas, x), int64_t(grads_mode));
}

// --- matching ------------------------------------------------------------------------------------------------------

// The distances (N, 1) of descriptors (N, D) from their nearest ones of (M, D), and the indices (N, 2) in both.
inline std::tuple<Tensor, Tensor> match_nn(Tensor const& desc1, Tensor const& desc2) {
  detail::descriptors("match_nn", desc1, desc2);
  Tensor const x = detail::computed(desc1, desc1), y = detail::computed(desc2, desc2);
  if (x.size(0) == 0 || y.size(0) == 0) return {x.new_zeros({0, 1}), at::zeros({0, 2}, x.options().dtype(at::kLong))};
  auto const [distances, indices, _, __] = ops::two_nearest(x.unsqueeze(0), y.unsqueeze(0), {}, {}, {}, {}, 0.0, false);
  Tensor const own = at::arange(x.size(0), indices.options());
  return {distances[0].narrow(1, 0, 1).to(desc1.scalar_type()),
          at::stack({own, indices[0].select(1, 0).clamp_min(0)}, 1)};
}

// Mutual nearest neighbors whose ratios of the nearest to the second nearest distance are at most th in both
// directions: the larger ratio (K, 1), and the indices (K, 2). Waits for a GPU.
inline std::tuple<Tensor, Tensor> match_smnn(Tensor const& desc1, Tensor const& desc2, double th = 0.95) {
  detail::descriptors("match_smnn", desc1, desc2);
  Tensor const x = detail::computed(desc1, desc1), y = detail::computed(desc2, desc2);
  auto const longs = x.options().dtype(at::kLong);
  if (x.size(0) < 2 || y.size(0) < 2) return {x.new_zeros({0, 1}), at::zeros({0, 2}, longs)};
  at::NoGradGuard no_grad;
  auto const [distances1, indices1, distances2, indices2] =
      ops::two_nearest(x.unsqueeze(0), y.unsqueeze(0), {}, {}, {}, {}, 0.0, true);
  auto const [scores, indices, sizes] =
      ops::select_matches(distances1, indices1, distances2, indices2, y.size(0), true, th);
  int64_t const count = sizes.item<int64_t>();
  return {scores[0].narrow(0, 0, count).unsqueeze(1).to(desc1.scalar_type()), indices[0].narrow(0, 0, count)};
}

// --- patches, as python/kvision/feature/patches.py, sift.py, orientation.py and affine_shape.py have them

namespace detail {

inline Tensor sample_levels(char const* op, std::vector<Tensor> const& levels, Tensor const& laf, int64_t size) {
  Tensor const& image = levels[0];
  Tensor const x = frames(op, "laf", laf);
  TORCH_CHECK_VALUE(x.size(0) == image.size(0), op, ": expected laf for ", image.size(0), " images, got ", x.size(0));
  TORCH_CHECK_VALUE(size > 0, op, ": expected PS of at least 1, got ", size);
  std::vector<Tensor> rows;
  for (Tensor const& level : levels) rows.push_back(level.flatten(2));
  Tensor const pyramid = rows.size() == 1 ? rows[0] : at::cat(rows, 2);
  return ops::sample_patches(pyramid, computed(x, image), image.sizes().slice(2).vec(), int64_t(levels.size()), size,
                             double(size));
}
inline Tensor square_patches(char const* op, Tensor const& x) {
  TORCH_CHECK_VALUE(x.dim() == 4 && x.size(1) == 1 && x.size(2) == x.size(3) && x.size(2) > 0, op,
                    ": expected patches of shape (B, 1, n, n), got ", x.sizes());
  return floats(x);
}

}  // namespace detail

// Patches (B, N, C, PS, PS) of frames in pixels of the images.
inline Tensor extract_patches_simple(Tensor const& img, Tensor const& laf, int64_t PS = 32) {
  detail::images("extract_patches_simple", "img", img);
  return detail::sample_levels("extract_patches_simple", {detail::floats(img)}, laf, PS);
}
inline Tensor extract_patches_from_pyramid(Tensor const& img, Tensor const& laf, int64_t PS = 32) {
  detail::images("extract_patches_from_pyramid", "img", img);
  std::vector<Tensor> levels{detail::floats(img)};
  for (int64_t side = std::min(img.size(2), img.size(3)); side > 2 && side / 2 >= PS && levels.size() < 16; side /= 2)
    levels.push_back(pyrdown(levels.back()));
  return detail::sample_levels("extract_patches_from_pyramid", levels, laf, PS);
}

struct SiftOptions {
  TORCH_ARG(int64_t, num_ang_bins) = 8;
  TORCH_ARG(int64_t, num_spatial_bins) = 4;
  TORCH_ARG(bool, rootsift) = true;
  TORCH_ARG(double, clipval) = 0.2;
};
// Descriptors (B, num_ang_bins num_spatial_bins^2) of patches (B, 1, n, n).
inline Tensor sift_descriptor(Tensor const& patches, SiftOptions const& options = {}) {
  return ops::sift(detail::square_patches("sift_descriptor", patches), options.num_ang_bins(),
                   options.num_spatial_bins(), options.clipval(), options.rootsift());
}
// Angles (B,) of patches (B, 1, n, n), in radians, counter-clockwise as seen in the image.
inline Tensor dominant_orientation(Tensor const& patches, int64_t num_angular_bins = 36, double eps = 1e-8) {
  return ops::orientation(detail::square_patches("dominant_orientation", patches), num_angular_bins, eps, 1, 1.0)
      .squeeze(1);
}
// Ellipses (B, 1, 3) of patches (B, 1, n, n).
inline Tensor affine_shape(Tensor const& patches, double eps = 1e-10) {
  return ops::affine_shape(detail::square_patches("affine_shape", patches), eps).unsqueeze(1);
}

}  // namespace kvision
